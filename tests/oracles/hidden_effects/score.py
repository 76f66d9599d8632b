"""The table of goals from a bank's diagnoses: `python -m hidden_effects.score DIR OUT [--figure power.png]`.

A diagnosis is right, wrong or a miss: right: every true effect named (itself or among the alternatives of a named one),
nothing else named, a fitting verdict; wrong: a name that is not true, with the verdict "named" or "partial"; miss:
anything else.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hidden_effects.effects import NAMED_SINCE, UNKNOWN

SEPARABLE_FROM = 1.0  # times the noise, left after recalibration
BINS = ((0.5, 0.8), (0.8, 0.95), (0.95, 0.99), (0.99, 1.0))  # of probabilities, whose share that is right is counted
Names = list[set[str]]


@dataclass(frozen=True)
class Trial:
    """One set: its truth.json, its diagnosis.json (None if there is none), and the seconds it took."""

    name: str
    truth: dict[str, Any]
    found: dict[str, Any] | None
    seconds: float = math.nan

    @property
    def row(self) -> str:
        return str(self.truth["case"]["row"])

    @property
    def verdict(self) -> str:
        return str(self.found["verdict"]) if self.found else "none"

    @property
    def named(self) -> Names:
        return [{e["name"], *e.get("alternatives", [])} for e in self.found["effects"]] if self.found else []

    @property
    def known(self) -> Names:
        return [set(e.split("|")) for e in self.truth["effects"] if e != "unknown"]

    @property
    def has_unknown(self) -> bool:
        return "unknown" in self.truth["effects"]

    @property
    def extra(self) -> Names:
        """Named and not true."""
        return [n for n in self.named if not any(n & k for k in self.known)]

    @property
    def is_right(self) -> bool:
        if self.found is None:
            return False
        if self.has_unknown:
            verdicts = {"unexplained", "partial"}
        else:
            verdicts = {"named", "ambiguous"} if self.known else {"no_missing_effect"}
        all_named = all(any(k & n for n in self.named) for k in self.known)
        return all_named and not self.extra and self.verdict in verdicts

    @property
    def is_wrong(self) -> bool:
        return bool(self.extra) and self.verdict in ("named", "partial")

    @property
    def outcome(self) -> str:
        return "right" if self.is_right else "WRONG" if self.is_wrong else "miss"

    @property
    def acting(self) -> set[str]:
        """Effects of the catalogue that act, each by the name that it was made by."""
        case = self.truth["case"]
        hidden = [name for name, _ in case["hidden"]]
        of_release = {"friction"} if "translation_release" in hidden else set()
        names = {"homing_offset" if name.startswith("homing") else name for name in hidden if name not in UNKNOWN}
        named_since = {NAMED_SINCE[name] for name in hidden if name in NAMED_SINCE}
        return (names | of_release | named_since) - {case.get("left_out")}

    @property
    def probabilities(self) -> list[tuple[float, bool]]:
        """The probability of every effect of the catalogue that may act, and whether it does."""
        posterior = (self.found or {}).get("posterior") or {"effects": {}}
        return [(p, name in self.acting) for name, p in posterior["effects"].items()]

    @property
    def listed_probabilities(self) -> list[tuple[float, bool]]:
        """The probability of every effect that the verdict lists, and whether it acts."""
        return [(e["probability"], e["name"] in self.acting) for e in (self.found or {}).get("effects", [])]

    @property
    def verdict_probability(self) -> list[tuple[float, bool]]:
        """The probability of the verdict, and whether it is right."""
        p = (self.found or {}).get("verdict_probability")
        return [] if p is None else [(p, self.is_right)]

    @property
    def unknown_probability(self) -> list[tuple[float, bool]]:
        """Probability that something acts which the catalogue lacks, and whether it does."""
        posterior = (self.found or {}).get("posterior")
        return [(posterior["unknown"], self.has_unknown)] if posterior else []

    @property
    def leftover(self) -> float:
        return float(self.truth["leftover_over_noise"])


def read(bank: Path, out: Path) -> list[Trial]:
    """Every folder of the bank that was run."""
    trials = []
    for path in sorted(bank.glob("*/truth.json")):
        target = out / path.parent.name
        answer, run = target / "diagnosis.json", target / "run.json"
        if answer.exists() or run.exists():
            found = json.loads(answer.read_text(encoding="utf-8")) if answer.exists() else None
            seconds = json.loads(run.read_text(encoding="utf-8"))["seconds"] if run.exists() else math.nan
            trials.append(Trial(path.parent.name, json.loads(path.read_text(encoding="utf-8")), found, seconds))
    return trials


def wilson(hits: int, trials: int) -> tuple[float, float]:
    """95 % interval of a proportion; (0, 1) without trials."""
    if trials == 0:
        return 0.0, 1.0
    z, p = 1.959964, hits / trials
    middle, half = p + z * z / (2 * trials), z * math.sqrt(p * (1 - p) / trials + z * z / (4 * trials * trials))
    scale = 1 + z * z / trials
    return max(0.0, (middle - half) / scale), min(1.0, (middle + half) / scale)


@dataclass(frozen=True)
class Goal:
    """One line of the table: hits among trials, and what is asked of their share."""

    text: str
    asked: str
    hits: int
    trials: int

    def line(self) -> str:
        if not self.trials:
            return f"| {self.text} | {self.asked} | - | 0 | |"
        low, high = wilson(self.hits, self.trials)
        share = f"{100 * self.hits / self.trials:.1f} %"
        return f"| {self.text} | {self.asked} | {share} | {self.trials} | {100 * low:.1f} to {100 * high:.1f} % |"


def goals(trials: list[Trial]) -> list[Goal]:
    """The rows of the table of goals in diagnosis.md that a bank can fill."""
    nulls = [t for t in trials if t.row == "null"]
    rough = [t for t in trials if t.row in ("null, heavy tails", "null, misstated noise")]
    every_null = [t for t in trials if t.row.startswith("null")]
    correlated = [t for t in trials if t.row == "null, correlated"]
    singles = [t for t in trials if t.row == "single" and t.leftover >= SEPARABLE_FROM]
    heavy = [t for t in trials if t.row == "single, heavy tails" and t.leftover >= SEPARABLE_FROM]
    pairs = [t for t in trials if t.row == "pair"]
    foreign = [t for t in trials if t.row in ("not in the catalogue", "taken out of the catalogue") and t.has_unknown]
    mixed = [t for t in trials if t.row == "known and unknown" and t.has_unknown]
    slips = [t for t in trials if {"homing_shift"} in t.known or {"frame_shift"} in t.known]
    look_alikes = [t for t in trials if t.row == "look-alike" and t.leftover >= SEPARABLE_FROM]
    right = [t for t in trials if t.is_right and t.known]
    covered = [inside for t in right for inside in intervals(t)]
    return [
        _goal("names in nulls, correlated ones among them", "<= 2 %", every_null, lambda t: bool(t.named)),
        _goal("the same, correlated ones alone", "<= 2 %", correlated, lambda t: bool(t.named)),
        _goal("false alarm on nulls", "<= 5 %", nulls, lambda t: t.verdict != "no_missing_effect"),
        _goal("the same, heavy tails or misstated noise", "", rough, lambda t: t.verdict != "no_missing_effect"),
        _goal("right name, single effect that leaves >= 1x noise", ">= 95 %", singles, lambda t: t.is_right),
        _goal("the same, heavy tails", "", heavy, lambda t: t.is_right),
        _goal("both right, pairs", "", pairs, lambda t: t.is_right),
        _goal("confident wrong name, all sets", "<= 2 %", trials, lambda t: t.is_wrong),
        Goal("wrong, of listed names with a probability above 0.99", "<= 1 %", *_wrong_of_certain(trials)),
        _goal("effect not in the catalogue, given a name", "<= 5 %", foreign, lambda t: bool(t.extra) and _claims(t)),
        _goal("the same, with a probability above 0.99", "", foreign, lambda t: any(p > 0.99 for p in _wrong(t))),
        _goal("gap halved, of unknown effects that leave >= 1x noise", ">= 70 %", _large(foreign), _halves_gap),
        _goal("known part listed, where an unknown effect acts besides", ">= 85 %", mixed, _lists_known),
        _goal("slips and knocks named", ">= 90 %", slips, lambda t: any(n & k for n in t.named for k in t.known)),
        _goal("look-alikes reported as A or B, truth inside", ">= 90 %", look_alikes, _says_either),
        Goal("95 % intervals that contain the true value", "93-97 %", sum(covered), len(covered)),
        _goal("gap after adding <= 1.1x noise floor, right ones", "all", right, _closes_gap),
        _goal("the same, its 95 % interval reaches that", "", right, lambda t: _closes_gap(t, interval=True)),
        _goal("no region more than 5 % worse, right ones", "all", right, _hurts_nowhere),
        _goal("answered within 5 minutes", "all", trials, lambda t: t.found is not None and not t.seconds > 300),
    ]


def reliability(trials: list[Trial]) -> list[Goal]:
    """How much is true of what was given a probability in each bin."""
    kinds: list[tuple[str, Callable[[Trial], list[tuple[float, bool]]]]] = [
        ("effect acts", lambda t: t.probabilities),
        ("listed effect acts", lambda t: t.listed_probabilities),
        ("verdict is right", lambda t: t.verdict_probability),
        ("something unknown acts", lambda t: t.unknown_probability),
    ]
    rows = []
    for text, of in kinds:
        told = [one for t in trials for one in of(t)]
        for low, high in BINS:
            inside = [true for p, true in told if low <= p < high or p == high == 1]
            rows.append(Goal(f"{text}, p {low:g} to {high:g}", "inside", sum(inside), len(inside)))
    return rows


def _goal(text: str, asked: str, trials: list[Trial], is_hit: Callable[[Trial], bool]) -> Goal:
    return Goal(text, asked, sum(is_hit(t) for t in trials), len(trials))


def _claims(trial: Trial) -> bool:
    return trial.verdict in ("named", "ambiguous", "partial")


def _lists_known(trial: Trial) -> bool:
    return all(any(k & n for n in trial.named) for k in trial.known)


def _wrong(trial: Trial) -> list[float]:
    """Probabilities of effects that are listed and do not act."""
    return [p for p, is_true in trial.listed_probabilities if not is_true]


def _wrong_of_certain(trials: list[Trial]) -> tuple[int, int]:
    certain = [is_true for t in trials for p, is_true in t.listed_probabilities if p > 0.99]
    return certain.count(False), len(certain)


def _large(trials: list[Trial]) -> list[Trial]:
    return [t for t in trials if t.leftover >= SEPARABLE_FROM]


def _halves_gap(trial: Trial) -> bool:
    """On unseen poses, the noise taken out."""
    gap = _gap(trial)
    before, after = (gap[key] ** 2 - gap["noise_floor_mm"] ** 2 for key in ("before_rms_mm", "after_rms_mm"))
    return bool(after <= before / 4)


def _says_either(trial: Trial) -> bool:
    """Named together with its look-alike, nothing else named."""
    return not trial.extra and any(k <= n for k in trial.known for n in trial.named)


def _gap(trial: Trial) -> dict[str, Any]:
    return (trial.found or {}).get("gap") or {}


def _closes_gap(trial: Trial, *, interval: bool = False) -> bool:
    """A vault of 20 poses knows its own rms to 10 %, which its interval says."""
    gap = _gap(trial)
    after = gap["after"]["rms_ci95_mm"][0] if interval else gap["after_rms_mm"]
    return float(after) <= 1.1 * float(gap["noise_floor_mm"])


def _hurts_nowhere(trial: Trial) -> bool:
    regions = _gap(trial)["regions"].values()
    return all(region["after"]["rms_mm"] <= 1.05 * region["before"]["rms_mm"] for region in regions)


def pooled_gap(trials: list[Trial]) -> tuple[float, float]:
    """Rms over the unseen poses of all right ones, over the noise: before and after the effects are added."""
    right = [_gap(t) for t in trials if t.is_right and t.known]
    poses = np.array([gap["heldout_poses"] for gap in right], dtype=float)
    ratios = [
        np.array([gap[key] / gap["noise_floor_mm"] for gap in right]) for key in ("before_rms_mm", "after_rms_mm")
    ]
    before, after = (math.sqrt(float(poses @ ratio**2 / poses.sum())) if right else math.nan for ratio in ratios)
    return before, after


def intervals(trial: Trial) -> Iterable[bool]:
    """For every parameter of an effect that truth has by the same names: whether its interval contains the truth.

    What truth leaves out of an effect is zero: other tubes, other axes.
    """
    for effect in (trial.found or {}).get("effects", []):
        true = trial.truth["parameters"].get(_key(trial, effect["name"]), {})
        fitted = effect.get("parameters", {})
        if not set(true) & set(fitted):
            continue
        for name, parameter in fitted.items():
            if parameter.get("ci95"):
                low, high = parameter["ci95"]
                yield low <= true.get(name, 0.0) <= high


def _key(trial: Trial, name: str) -> str:
    """Offsets have two names in truth.json's parameters."""
    if name == "homing_offset":
        return next((k for k in trial.truth["parameters"] if k.startswith("homing")), name)
    return "translation_release" if name == "friction" and "friction" not in trial.truth["parameters"] else name


def power(trials: list[Trial]) -> dict[str, list[tuple[float, bool]]]:
    """Per effect, (leftover over noise, right name) of every single."""
    curve: dict[str, list[tuple[float, bool]]] = {}
    for t in trials:
        if t.row in ("single", "look-alike"):
            curve.setdefault(t.truth["case"]["hidden"][0][0], []).append((t.leftover, t.is_right))
    return {name: sorted(points) for name, points in sorted(curve.items())}


def draw_power(curve: dict[str, list[tuple[float, bool]]], path: Path) -> None:
    """Right name against effect size over noise, one line of dots per effect."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 0.6 + 0.3 * max(len(curve), 1)), layout="constrained")
    for k, points in enumerate(curve.values()):
        size, right = np.array([p[0] for p in points]), np.array([p[1] for p in points], dtype=bool)
        axes.plot(size[right], np.full(right.sum(), k), "o", color="tab:blue")
        axes.plot(size[~right], np.full((~right).sum(), k), "x", color="tab:red")
    axes.set_yticks(range(len(curve)), list(curve))
    axes.set_xscale("log", base=2)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("left after recalibration, over the noise (dot: right name, cross: not)")
    axes.axvline(SEPARABLE_FROM, color="grey", linewidth=0.8)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def print_table(trials: list[Trial]) -> None:
    print("\n| | goal | share | trials | 95 % interval |\n|---|---|---|---|---|")
    for goal in goals(trials):
        print(goal.line())
    print("\n| probability | goal | true | trials | 95 % interval |\n|---|---|---|---|---|")
    for goal in reliability(trials):
        print(goal.line())
    seconds = float(np.median([t.seconds for t in trials])) if trials else math.nan
    print(f"\n{seconds:.0f} s in the median")
    before, after = pooled_gap(trials)
    print(f"\n{len(trials)} sets; rms on unseen poses of the right ones: {before:.2f} -> {after:.2f} times the noise")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bank", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--development", nargs="*", default=[], help="cases that faults were found on: kept apart")
    parser.add_argument("--power", type=Path, help="write the points of the power curve as JSON")
    given = parser.parse_args()
    trials = read(given.bank, given.out)
    for t in trials:
        named = [sorted(n) for n in t.named]
        print(
            f"{t.name}  {t.outcome:5}  {t.row}: {t.verdict} {named}, true {t.truth['effects']} at {t.leftover}x noise"
        )
    print_table([t for t in trials if t.name not in given.development])
    if given.development:
        print("\ncases of development")
        print_table([t for t in trials if t.name in given.development])
    curve = power(trials)
    if given.power:
        given.power.write_text(json.dumps(curve, indent=1) + "\n", encoding="utf-8")
    if given.figure:
        draw_power(curve, given.figure)


if __name__ == "__main__":
    main()
