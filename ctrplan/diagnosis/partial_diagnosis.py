"""A part of the truth: effects that act although something else remains, and a term that is built of what remains.

It begins where nothing in the catalogue leaves noise alone. What no effect explains gets a size and a memory, so that
poses count for as much as they say, and sets of effects are compared beside everything unknown, `posterior.py`. An
effect of the most probable set is told where it acts with 0.99, alone or together with what may stand for it.

What acts at a stage of the chain is more probable as a term of that stage than as an error of tips. So pieces are taken
one by one, each where it makes all poses more probable beside the most probable error of tips, by more than the choice
among all pieces costs. Then the catalogue is asked anew beside what was built, which may have hidden a name or stood
for one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.calibration.discrepancy import Linearised
from ctrplan.calibration.least_squares import Fit
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis.adequacy import Adequacy, remains
from ctrplan.diagnosis.conclusion import Built, Conclusion, Round, mean_square
from ctrplan.diagnosis.correlated_bench import FRAMES, HOMED, SHIFT, CorrelatedBench, frames_beside
from ctrplan.diagnosis.next_experiment import SEPARATING_LOG_ODDS
from ctrplan.diagnosis.posterior import MOST_EFFECTS, settled
from ctrplan.diagnosis.remainder import Remainder, localise, shares
from ctrplan.diagnosis.term_pieces import TermPiece, WideLinearisation, is_built, pieces, wide_linearisation, with_piece
from ctrplan.diagnosis.unknown_errors import Peak, UnknownErrors
from ctrplan.diagnosis.usable_poses import blocks, on_one_branch, thinned, thinning
from ctrplan.diagnosis.verdict import NAMED, Judgement, Verdict, done_by, findings_of, without_shared
from ctrplan.diagnosis.workbench import Candidates, Scored, Teller, Workbench, linear
from ctrplan.effects.learned.learned import Learned
from ctrplan.measurement.measurements import Measurements, Split, split
from ctrplan.pipeline.term import Term
from ctrplan.robot.robot import Robot

TRIED = 4  # pieces that are fitted in each round, of those that promise more than one has or as much as the first


def diagnose_partially(
    robot: Robot,
    data: Measurements,
    usable: NDArray[np.bool_],
    noise: Noise,
    known: Candidates,
    tell: Teller,
    begun: Fit | None = None,
) -> Conclusion:
    """Searches, asks what holds, and describes the rest; `usable` (K,) are the poses to go by.

    begun: a calibration of like poses, near which these are calibrated.
    """
    tell("looking for what holds beside a rest")
    block = blocks(data, _memory(robot, data, usable, noise, begun))
    parts = thinned(split(usable, block), data)
    bench = _bench(robot, data, noise, parts, block)
    framed = bench.scored([], begun)
    corrected, here = bench.corrected(framed)
    if not (certain := on_one_branch(corrected, here)).all():
        parts = Split(parts.selection[certain], parts.held_out_set)
        bench = _bench(robot, data, noise, parts, block)
        corrected, here = bench.corrected(bench.scored([], framed.fit))
    base = Workbench(robot, bench.data, noise, bench.group).scored([], begun)
    right, nothing = np.zeros(data.count, bool), Judgement("unexplained", (), remains(bench, base))
    calibrated = Conclusion(bench, known, parts, block, right, noise, base, base, nothing)
    return most_probable(calibrated, corrected, here, tell)


def _bench(robot: Robot, data: Measurements, noise: Noise, parts: Split, block: NDArray[np.int_]) -> CorrelatedBench:
    """The bench of the poses that choose."""
    return CorrelatedBench(robot, data.subset(parts.selection), noise, block[parts.selection])


def most_probable(before: Conclusion, bench: CorrelatedBench, begun: Scored, tell: Teller) -> Conclusion:
    """The most probable set from a settled one on, and what is told of it.

    What remains is what the catalogue leaves: a built term explains nothing.
    """
    known = before.known
    bench, compared, here, path = settled(bench, begun, testable_beside(known, bench), tell)
    testable = {SHIFT, HOMED, *(t.name for t in known.terms)}  # set-ups and homings are no matter of the catalogue
    free = [t for t in frames_beside(bench.robot, bench.data, here.terms) if t.name in testable]
    listed = [*free, *(t for t in here.terms if not is_built(t))]
    every = findings_of(bench, here, listed, known, compared.posterior, compared.sets)
    findings, _ = without_shared(bench, here, every)
    beside, named = _by_name(bench, here)
    verdict: Verdict = "partial" if findings else "unexplained"
    told = {f.term.key for f in findings}
    unnamed = [t for t in here.terms if t.key not in told and not is_built(t)]
    together = done_by(here, unnamed, compared.posterior, NAMED)  # beside names, which their figures may not save
    judgement = Judgement(verdict, findings, left_by_names(beside, named), together=together)
    rest, path = remainder_beside(beside, named, bench.plain), (*before.path, *path)
    return replace(before, bench=bench, chosen=here, judgement=judgement, rest=rest, path=path, compared=compared)


def testable_beside(known: Candidates, bench: CorrelatedBench) -> Candidates:
    """What may be missing beside a rest, free frames and, on a continuous motion, friction that follows its history."""
    always = {*FRAMES, "translation_release"} if bench.data.is_stream else {*FRAMES}
    return replace(known, terms=tuple(t for t in known.terms if t.name not in always and not t.effect.is_alone))


def left_by_names(bench: Workbench, chosen: Scored) -> Adequacy:
    """Whether noise alone is left without the built terms of a set, against the noise and not beside a rest."""
    if not isinstance(bench, CorrelatedBench):
        return remains(bench, chosen)
    beside, named = _by_name(bench, chosen)
    return remains(beside, beside.over_noise(named))


def _by_name(bench: CorrelatedBench, chosen: Scored) -> tuple[CorrelatedBench, Scored]:
    """The set without its built terms, on a bench whose discrepancy is all that these stand for, friction states as
    the terms leave them.
    """
    names = [t for t in chosen.terms if not is_built(t)]
    if len(names) == len(chosen.terms):
        return bench, chosen
    return bench.corrected(bench.scored(names, chosen.fit), is_followed=False)


def _memory(robot: Robot, data: Measurements, usable: NDArray[np.bool_], noise: Noise, begun: Fit | None) -> float:
    """The memory of the calibrated model's errors on a continuous motion, in s, or in rows where there are no times."""
    if not data.is_stream:
        return 0.0
    some = np.flatnonzero(usable)
    some = some[:: thinning(len(some))]
    alone = np.arange(len(some))
    bench = CorrelatedBench(robot, data.subset(some), noise, alone)
    return bench.estimated(bench.scored([], begun)).memory


def remainder_beside(bench: CorrelatedBench, chosen: Scored, noise: Noise) -> Remainder:
    """What remains beside a set of effects."""
    data, result = bench.data, bench.noise.discrepancy
    error, floor = bench.left_out_m(chosen), noise.floor_m
    size = float(np.sqrt(max(mean_square(error) - floor**2, 0.0)))
    distance = np.linalg.norm(error, axis=1)
    r = linear(chosen.fit).coloured(bench.noise).r
    place = localise(data, r, bench.group, distance, floor, "With these effects")
    if data.is_stream:
        memory = result.memory if result else 0.0
        parts = shares(error, data, floor, memory)
        return Remainder(size, memory, *parts, place.sentence, memory_in_rows=data.time_s is None)
    return Remainder(size, None, *shares(error, data, floor, 0.0), place.sentence, memory_in_rows=data.time_s is None)


def build(partial: Conclusion, tell: Teller) -> Conclusion | None:
    """A term of what remains, with the effects that hold beside it; None where none makes the poses more probable."""
    bench = partial.bench
    if not isinstance(bench, CorrelatedBench) or bench.is_noise_alone or partial.compared is None:
        return None
    in_time = any(partial.compared.posterior.along.get(name, 0.0) > 1 / 2 for name in ("time", "order"))
    bench, here, rounds = _grown(bench, partial.chosen, partial.known.terms, in_time, tell)
    if not any(is_built(t) for t in here.terms):
        return None
    steps = (*partial.path, *(turn.step for turn in rounds))
    again = most_probable(replace(partial, path=steps, before=partial), bench, here, tell)
    bench, scored = again.bench, again.chosen
    if not isinstance(bench, CorrelatedBench) or not any(is_built(t) for t in scored.terms):
        return None
    plain = bench.scored([t for t in scored.terms if not is_built(t)], scored.fit)
    before, after = mean_square(bench.left_out_m(plain)), mean_square(bench.left_out_m(scored))
    share = (before - after) / max(before - bench.plain.floor_m**2, 1e-12)
    rest = remainder_beside(bench, scored, bench.plain)
    return replace(again, chosen=_with_sizes(scored), built=Built(plain, tuple(rounds), share, rest))


def _grown(
    bench: CorrelatedBench, chosen: Scored, named: Sequence[Term], in_time: bool, tell: Teller
) -> tuple[CorrelatedBench, Scored, list[Round]]:
    """The set with pieces beside it, its bench, and the rounds that were asked.

    named: effects that no piece stands for; in_time: whether pieces may change with time.
    """
    here, rounds = chosen, list[Round]()
    every = pieces(bench.robot, bench.data, named, in_time=in_time)
    known = [piece for piece in every if piece.on.effect_name not in bench.robot.effects]
    choice = float(np.log(max(len(known), 1)))
    while len(rounds) < MOST_EFFECTS and known:
        tell("building a term beside " + (", ".join(here.names) or "the calibrated robot"))
        root = np.sqrt(np.where(here.failed, 0.0, here.fit.residuals.weight))
        of_here = linear(here.fit).centred(bench.noise, root)
        errors = UnknownErrors(bench, here, here, [of_here], root, with_stages=False)
        before, peak = errors.evidence(of_here)
        table = wide_linearisation(bench, here, known)
        ranked = _ranked(table, table.whole.centred(bench.noise, root), peak, choice)
        best: tuple[float, TermPiece, Scored] | None = None
        for piece, promised in ranked[:TRIED]:
            if best is not None and promised <= min(best[0], ranked[0][1] - SEPARATING_LOG_ODDS):
                break
            there = bench.scored(with_piece(here.terms, piece, table.ranges[piece], bench), here.fit)
            after, _ = errors.evidence(linear(there.fit).centred(bench.noise, root))
            gain = after - before - choice
            if best is None or gain > best[0]:
                best = gain, piece, there
        assert best is not None
        taken = best[1] if best[0] > 0 else None
        rounds.append(Round(tuple(ranked), best[0], taken))
        if taken is None:
            break
        bench, here = bench.corrected(best[2], is_followed=False)
        known = [piece for piece in known if piece != taken]
    if here is not chosen:  # friction states follow when all is built
        bench, here = bench.corrected(here)
    return bench, here, rounds


def _ranked(table: WideLinearisation, whole: Linearised, peak: Peak, choice: float) -> list[tuple[TermPiece, float]]:
    """Pieces by what they gain to first order beside the most probable error of tips, best first."""
    spectrum, own = peak.error.at(whole, peak.position, peak.tangent), list(range(table.own))

    def evidence(columns: list[int]) -> float:
        return float(spectrum.of(columns).evidences(0, 0)) / 2

    plain = evidence(own)
    gains = [(piece, evidence([*own, *places]) - plain - choice) for piece, places in table.places.items()]
    return sorted(gains, key=lambda entry: -entry[1])


def _with_sizes(scored: Scored) -> Scored:
    """The set with how far terms of the mechanics move a tip of the data, which margins allow for."""
    chain, p, noted = scored.fit.chain, scored.fit.p, dict[str, Term]()
    here = chain.predict(p, derivatives=False).position_m
    for t, place in zip(chain.terms, chain.slices(), strict=True):
        if isinstance(t.effect, Learned) and t.effect.stage == "mechanics" and t.effect.target.kind_name != "plate":
            without = p.copy()
            without[place] = 0.0
            moved = np.linalg.norm(chain.predict(without, derivatives=False).position_m - here, axis=1)
            largest_mm = float(f"{1e3 * moved.max():.3g}")
            noted[t.key] = Term(t.effect.with_largest(largest_mm, chain.robot.n), t.parameters)
    if not noted:
        return scored
    terms = [noted.get(t.key, t) for t in chain.terms]
    own = tuple(noted.get(t.key, t) for t in scored.terms)
    return Scored(own, replace(scored.fit, chain=chain.with_terms(terms)))
