"""Terms built of what remains: found where something no catalogue has acts, in its stage, and used by the robot."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tomli_w
from made_up_input import thorough
from measured_data import SIGMA_M, measured, pair_robot, waypoints

from ctrplan.__main__ import main
from ctrplan.calibration.least_squares import Fit
from ctrplan.calibration.observed_noise import noise_floor
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis import CATALOGUE, Diagnosis, diagnose, held_out, partial_diagnosis
from ctrplan.diagnosis.confirmation import confirm
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.held_out import Gap
from ctrplan.diagnosis.partial_diagnosis import diagnose_partially
from ctrplan.diagnosis.remainder import input_distances, kernel_modes
from ctrplan.diagnosis.term_pieces import HALF_WAVES, TermPiece, built_term, pieces, wide_linearisation, with_piece
from ctrplan.diagnosis.unknown_errors import SHORTEST
from ctrplan.diagnosis.usable_poses import usable_poses
from ctrplan.diagnosis.workbench import Scored, Teller, candidates
from ctrplan.effects.learned import parts
from ctrplan.effects.learned.inputs import InputRange, Target
from ctrplan.effects.learned.learned import named
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.measurement.approach import clock
from ctrplan.measurement.measurements import Measurements
from ctrplan.reports.diagnosis_figures import selection_errors
from ctrplan.reports.diagnosis_page import diagnosis_report_html
from ctrplan.reports.diagnosis_words import effect_lines, verdict_sentence

ROBOT = pair_robot()
PLAN = waypoints(ROBOT, 18)
RIPPLE_DEG = 7.0
OFFSET = {"sensor_offset": {"offset_x_mm": 0.6, "offset_y_mm": -0.4}}
FURTHER = {"sensor_offset": {"offset_x_mm": 6.0, "offset_y_mm": -4.0}}


def rippled(values: dict[str, dict[str, float]] | None = None, plan: Measurements = PLAN) -> Measurements:
    """Measured while gears turned tube 2 further, three times a turn: made without any built term."""
    theta = plan.theta_commanded.copy()
    theta[:, 1] += np.radians(RIPPLE_DEG) * np.sin(3 * theta[:, 1] + 0.5)
    return replace(measured(ROBOT, replace(plan, theta_commanded=theta), values), theta_commanded=plan.theta_commanded)


def warmed() -> Measurements:
    """Read further and further along a direction the warmer the room, which a column tells."""
    data = measured(ROBOT, PLAN)
    warm = 3.0 * np.sin(np.arange(len(PLAN.sequence)) / 40.0)
    shift = np.outer(warm[PLAN.rows], [0.2e-3, -0.3e-3, 0.1e-3])
    return replace(data, position_m=data.position_m + shift, more={"temperature_C": 21.0 + warm})


@cache
def found() -> Diagnosis:
    return diagnose(ROBOT, rippled(), catalogue={})


def test_a_ripple_of_gears_is_built_in_the_drive_and_nothing_is_named() -> None:
    built, gap = found().built, found().gap
    assert built is not None and found().verdict == "unexplained" and not found().listed
    assert found().judgement.adequacy.total.p < 1e-3  # a built term explains nothing
    (term,) = found().built_terms
    assert term.name == "learned_theta_2" and term.effect.stage == "drive"
    assert built.by_stage["drive"] > 1.5 * max(built.by_stage["mechanics"], built.by_stage["sensor"])
    rest = [np.sqrt(max(errors.rms_m**2 - gap.floor_m**2, 0.0)) for errors in (gap.before, gap.after)]
    assert rest[1] < 0.3 * rest[0]
    (told,) = found().to_json()["built"]["terms"]
    wave = [told["coefficients"][f"{name}_3_theta_2_deg"] for name in ("sin", "cos")]
    for one, true in zip(wave, RIPPLE_DEG * np.array([np.cos(0.5), np.sin(0.5)]), strict=True):
        low, high = one["ci95"]
        assert low - (high - low) / 2 < true < high + (high - low) / 2
    assert (
        told["may_be"].endswith("like a ripple of gears; that is no proof of a cause") and "120 deg" in told["may_be"]
    )


def test_the_robot_that_is_handed_over_turns_as_the_true_one() -> None:
    robot = robot_from_dict(found().robot_content())
    angle = np.linspace(-3.0, 3.0, 40)
    theta_b, _ = robot.collars(np.column_stack([0 * angle, angle]), np.tile([0.0, -0.01], (40, 1)))
    true = angle + np.radians(RIPPLE_DEG) * np.sin(3 * angle + 0.5)
    assert np.abs(theta_b[:, 1] - true - np.mean(theta_b[:, 1] - true)).max() < np.radians(1.2)


def test_what_the_catalogue_has_is_named_beside_a_built_term_that_had_hidden_it() -> None:
    data, quick = rippled(OFFSET), {name: CATALOGUE[name] for name in ("sensor_offset", "tip_load")}
    after = diagnose(ROBOT, data, catalogue=quick)
    assert after.verdict == "partial" and [t.name for t in after.listed] == ["sensor_offset"]
    assert [t.name for t in after.built_terms] == ["learned_theta_2"]
    assert set(after.robot_content()["effects"]) == {"sensor_offset", "learned_theta_2", "base_misalignment"}
    assert after.built is not None and after.partial is not None
    assert (
        after.partial.rest is not None
        and after.partial.rest.rms_m > 2 * after.built.rest.rms_m
        and after.judgement.adequacy.total.p < 1e-3
    )
    value = after.to_json()["effects"][0]["parameters"]["offset_x_mm"]["value"]
    assert value == pytest.approx(OFFSET["sensor_offset"]["offset_x_mm"], abs=0.15)


@thorough("test_what_the_catalogue_has_is_named_beside_a_built_term_that_had_hidden_it")
def test_names_stay_where_the_poses_kept_aside_take_the_term_back(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = held_out.open_test_set

    def further(before: Fit, after: Fit, *more: Any) -> Gap:
        gap = opened(before, after, *more)
        is_built = any(t.name.startswith("learned_") for t in after.chain.terms)
        return replace(gap, after=replace(gap.after, rms_m=1.0)) if is_built else gap

    monkeypatch.setattr(held_out, "open_test_set", further)
    after = diagnose(ROBOT, rippled(FURTHER), catalogue={"sensor_offset": CATALOGUE["sensor_offset"]})
    assert after.verdict == "partial" and [t.name for t in after.listed] == ["sensor_offset"]
    assert after.built is None and any("taken back" in note for note in after.notes)


def test_a_search_that_builds_nothing_leaves_what_was_found_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pieces that were looked for have a bench of their own: what remains is described on the one before."""
    beside, corrected, grown = list[tuple[str, ...]](), CorrelatedBench.corrected, partial_diagnosis._grown
    data = rippled()
    noise, usable = noise_floor(ROBOT, data)[0], usable_poses(ROBOT, data)
    before = diagnose_partially(ROBOT, data, usable, noise, candidates(ROBOT, data, {}), Teller())

    def noted(bench: CorrelatedBench, scored: Scored, **how: bool) -> tuple[CorrelatedBench, Scored]:
        beside.append(scored.names)
        return corrected(bench, scored, **how)

    def vain(bench: CorrelatedBench, chosen: Scored, *more: Any) -> tuple[CorrelatedBench, Scored, list[Any]]:
        return bench, chosen, grown(bench, chosen, *more)[2]

    noise_before = before.bench.noise
    monkeypatch.setattr(partial_diagnosis, "_grown", vain)
    monkeypatch.setattr(CorrelatedBench, "corrected", noted)
    assert partial_diagnosis.build(before, Teller()) is None
    assert ("learned_theta_2",) in beside
    assert before.bench.noise is noise_before and before.chosen.fit.noise is noise_before


def test_a_robot_that_has_its_term_lacks_nothing_more() -> None:
    again = diagnose(robot_from_dict(found().robot_content()), rippled(), catalogue={})
    assert again.verdict == "no_missing_effect" and again.built is None
    assert again.robot_content()["effects"]["learned_theta_2"] == found().robot_content()["effects"]["learned_theta_2"]


def test_terminal_and_report_say_what_was_built_and_that_it_is_no_cause() -> None:
    assert "Built of the rest: a term that changes the rotation of tube 2" in verdict_sentence(found())
    page = diagnosis_report_html(found(), selection_errors(found()))
    assert "built: a built term of the rotation of tube 2" in page and "no proof of a cause" in page
    assert "Range in the data; held at its edge outside" in page


def test_a_frame_beside_a_built_term_is_told_and_not_named() -> None:
    (line,) = [line for line in effect_lines(found()) if "free in every fit" in line]
    assert line.startswith("the base's frame is turned by") and "is not told" in line


def test_a_sensor_that_drifts_with_the_temperature_is_told_from_the_drive() -> None:
    (term,) = diagnose(ROBOT, warmed(), catalogue={}).built_terms
    assert term.name == "learned_sensor"
    assert list(term.effect.inputs) == ["temperature_C"]  # type: ignore[attr-defined]


def breathed() -> Measurements:
    """Measured while the inner tube was curved more and less, once each: made without any built term."""
    plan = replace(PLAN, time_s=3.0 * np.arange(len(PLAN.sequence)))
    low, high = (measured(ROBOT, plan, {"calibration": {"precurvature_factor_2_2": f}}) for f in (0.9, 1.1))
    share = (1 + np.sin(2 * np.pi * PLAN.rows / PLAN.rows[-1] + 0.4))[:, None] / 2
    position, tangent = (
        (1 - share) * a + share * b for a, b in ((low.position_m, high.position_m), (low.tangent, high.tangent))
    )
    return replace(low, position_m=position, tangent=tangent / np.linalg.norm(tangent, axis=1)[:, None])


def test_a_tube_that_changes_with_time_is_told_from_the_sensor_and_other_runs_lack_it() -> None:
    diagnosis = diagnose(ROBOT, breathed(), catalogue={})
    assert [t.name for t in diagnosis.built_terms] == ["learned_curvature_2"]
    assert list(diagnosis.built_terms[0].effect.inputs) == ["time"]  # type: ignore[attr-defined]
    rest = [np.sqrt(max(e.rms_m**2 - diagnosis.gap.floor_m**2, 0)) for e in (diagnosis.gap.before, diagnosis.gap.after)]
    assert rest[1] < 0.6 * rest[0]  # the poses kept aside are of times before and after, too
    later = confirm(diagnosis, measured(ROBOT, PLAN, seed=9))
    assert not later.effects and later.after.rms_m < later.calibrated.rms_m


def test_time_is_an_input_only_where_what_remains_goes_along_with_it() -> None:
    timed = replace(PLAN, time_s=3.0 * np.arange(len(PLAN.sequence)))
    assert not any("over_time" in part for piece in pieces(ROBOT, timed) for part in piece.parts)
    swings = {part for piece in pieces(ROBOT, timed, in_time=True) for part in piece.parts if "over_time" in part}
    assert {"sin_1_over_time", "cos_9_over_time"} <= swings
    for without in (
        replace(PLAN, time_s=None),
        replace(timed, is_stream=True),
    ):  # all of a stream goes
        assert pieces(ROBOT, without, in_time=True) == pieces(ROBOT, without)


def test_what_goes_with_time_is_known_over_the_whole_experiment() -> None:
    """Poses kept aside before the first that chooses, and after the last, are not taken for those."""
    timed = replace(rippled(), time_s=3.0 * np.arange(len(PLAN.sequence)))
    some = np.flatnonzero((PLAN.configuration > 2) & (PLAN.configuration < 15))
    bench = CorrelatedBench(ROBOT, timed.subset(some), Noise(SIGMA_M, 1e-3), PLAN.configuration[some])
    piece = next(p for p in pieces(ROBOT, timed, in_time=True) if "sin_3_over_time" in p.parts)
    span = wide_linearisation(bench, bench.scored([]), [piece]).ranges[piece]["time"]
    assert (span.low, span.high) == (0.0, timed.time_s[-1])


def test_a_process_in_time_does_what_a_piece_in_time_does() -> None:
    timed = replace(PLAN, time_s=3.0 * np.arange(len(PLAN.sequence)))
    square = dict(input_distances(timed))["time"]
    modes, when = kernel_modes(square / SHORTEST**2), clock(timed)
    for half_waves in range(1, HALF_WAVES + 1):
        wave = np.sin(np.pi * half_waves * (when - when.min()) / np.ptp(when))
        left = wave - modes @ np.linalg.solve(modes.T @ modes + 1e-2 * np.eye(modes.shape[1]), modes.T @ wave)
        assert (left @ left) < 0.02 * (wave @ wave)


def test_a_piece_acts_as_the_effect_that_is_made_of_it() -> None:
    noise, alone = Noise(SIGMA_M, 1e-3), PLAN.configuration
    bench = CorrelatedBench(ROBOT, rippled(), noise, alone)
    here = bench.scored([])
    known = [piece for piece in pieces(ROBOT, bench.data) if not piece.on.of_way]
    some = [next(p for p in known if p.on.kind_name == kind) for kind in ("theta", "l", "bend", "stiffness", "plate")]
    some.append(TermPiece(known[-1].on, ("slope_z",)))
    table = wide_linearisation(bench, here, some)
    for piece in some:
        term = built_term(piece.on, piece.names, table.ranges[piece], ROBOT.n)
        panel = bench.panel(here, [term])
        place = [k for k, (name, _) in enumerate(panel.keys) if name == term.name]
        np.testing.assert_allclose(
            table.whole.J[:, :, table.places[piece]],
            panel.whole.J[:, :, place],
            rtol=2e-3,
            atol=2e-3 * np.abs(panel.whole.J[:, :, place]).max(),
        )
        assert set(here.fit.chain.keys) < set(panel.keys)


def test_pieces_that_an_effect_of_the_catalogue_is_are_left_to_it() -> None:
    data, alone = rippled(), PLAN.configuration
    few = {name: CATALOGUE[name] for name in ("backlash", "homing_offset", "joint_scale", "eccentricity")}
    known = candidates(ROBOT, data, few).terms
    gone = [piece for piece in pieces(ROBOT, data) if piece not in pieces(ROBOT, data, known)]
    assert {piece.parts[0] for piece in gone} == {
        "sign_theta_2", "constant", "slope_theta_2", "slope_l_2", "sin_1_theta_2"
    }  # fmt: skip
    bench = CorrelatedBench(ROBOT, data, Noise(SIGMA_M, 1e-3), alone)
    here = bench.scored([])
    table, theirs = wide_linearisation(bench, here, gone), bench.panel(here, known)
    own = [k for k, (name, _) in enumerate(theirs.keys) if name in few]
    columns = theirs.whole.J[:, :, own].reshape(-1, len(own))
    for piece in gone:  # to first order the effect does what the piece does
        wanted = table.whole.J[:, :, table.places[piece]].reshape(columns.shape[0], -1)
        left = wanted - columns @ np.linalg.lstsq(columns, wanted, rcond=1e-10)[0]
        assert np.linalg.norm(left) < 5e-3 * np.linalg.norm(wanted)


@pytest.mark.parametrize(
    ("kind", "turns"), [("theta", True), ("bend", True), ("curvature", False), ("stiffness", False)]
)
def test_a_slope_of_what_turns_a_tube_takes_its_arbitrary_zero_with_it(kind: str, turns: bool) -> None:
    """Else a screw that was taken for a bend by the translation would leave a wrong zero of a joint."""
    on = Target(kind, 2)
    spans, bench = {"l_2": InputRange(-0.1, 0.0), "turn_2": InputRange(-3.0, 3.0)}, SimpleNamespace(robot=ROBOT)
    slope, wave = (
        with_piece([], TermPiece(on, part), spans, bench)  # type: ignore[arg-type]
        for part in (("slope_l_2",), ("sin_2_turn_2",))
    )
    constant = named(on, "constant")
    assert [constant[0] in one[0].effect.parts for one in (slope, wave)] == [turns, False]  # type: ignore[attr-defined]


def test_polynomials_of_the_place_are_left_to_a_distortion() -> None:
    data = rippled()
    known = candidates(ROBOT, data, {"sensor_distortion": CATALOGUE["sensor_distortion"]}).terms
    gone = [piece for piece in pieces(ROBOT, data) if piece not in pieces(ROBOT, data, known)]
    assert {piece.on.kind_name for piece in gone} == {"sensor"}
    inputs = {part for piece in gone for part in piece.parts}
    assert {"slope_x", "square_z", "slope_x_times_slope_y"} <= inputs
    assert not any(word in part for part in inputs for word in ("bump", "knot", "_tx", "_ty", "_tz"))


def test_pieces_are_of_what_changes_and_of_what_may_still_be_missing() -> None:
    data = replace(rippled(), tangent=np.full_like(PLAN.tangent, np.nan))
    kinds = {piece.on.kind.stage for piece in pieces(ROBOT, data)}
    assert kinds == {"drive", "mechanics", "sensor"}
    assert {piece.on.kind.stage for piece in pieces(ROBOT, replace(data, of_collars=True))} == kinds - {"drive"}
    found = [parts.part(name, ROBOT.n) for piece in pieces(ROBOT, data) for name in piece.parts]
    inputs = {name for one in found if one is not None for name in parts.inputs(one)}
    assert inputs == {"theta_2", "turn_2", "l_2", "overlap_1", "load_1", "x", "y", "z"}  # tube 1 stands still


def test_the_command_writes_a_robot_that_says_where_it_leaves_its_data(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = found().robot_content()
    (tmp_path / "robot.toml").write_text(tomli_w.dumps(content))
    given = ["bound", str(tmp_path / "robot.toml"), "--theta-deg", "0", "40", "--l-mm", "0", "-10"]
    given += ["--accuracy", "search"]
    assert main(given) == 0
    assert "was built from data" not in capsys.readouterr().err
    content["effects"]["learned_theta_2"] |= {"slope_l_2_deg": 1.0}
    content["effects"]["learned_theta_2"]["range"]["l_2"] = [-30.0, -20.0]
    (tmp_path / "robot.toml").write_text(tomli_w.dumps(content))
    assert main(given) == 0
    assert "l_2 from -30 to -20 mm; here l_2 reaches -10 mm, and it is held at the edge" in capsys.readouterr().err


def test_rests_that_configurations_trade_build_nothing() -> None:
    data, rng = measured(ROBOT, PLAN), np.random.default_rng(4)
    own = rng.standard_normal((int(PLAN.configuration.max()) + 1, 3)) * 0.5e-3
    assert (
        diagnose(ROBOT, replace(data, position_m=data.position_m + own[PLAN.configuration]), catalogue={}).built is None
    )
