"""Optuna proposes designs, shares from 0 to 1. With the same seed and answers it proposes the same."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from ctrplan.errors import InputError

EXTRA = "pip install 'ctrplan[design]'"
JOURNAL = "optuna.journal"  # for Optuna's own tools: `optuna-dashboard optuna.journal`
NAME = "design"


def check_installed() -> None:
    """Raises InputError without Optuna."""
    if find_spec("optuna") is None:
        raise InputError(f"a search of designs needs Optuna: {EXTRA}", key="design")


class Sampler:
    """A study of Optuna, whose trials are written into a folder as they are told."""

    def __init__(
        self,
        names: Sequence[str],
        less_is_better: Sequence[bool],
        kind: Literal["tpe", "nsga2", "random"],
        seed: int,
        folder: Path,
    ) -> None:
        """Begins anew: what a folder's rows answer is told again, which takes no time. Raises InputError."""
        check_installed()
        import optuna
        from optuna.storages import JournalStorage
        from optuna.storages.journal import JournalFileBackend

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self.optuna, self.names = optuna, list(names)
        journal = folder / JOURNAL
        journal.unlink(missing_ok=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self.study = optuna.create_study(
                study_name=NAME,
                storage=JournalStorage(JournalFileBackend(os.fspath(journal))),
                sampler=self._sampler(kind, seed),
                directions=["minimize" if less else "maximize" for less in less_is_better],
            )
        self.space = {name: optuna.distributions.FloatDistribution(0.0, 1.0) for name in self.names}

    def ask(self, count: int) -> list[tuple[Any, tuple[float, ...]]]:
        """So many trials, each with its shares."""
        found = []
        for _ in range(count):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                trial = self.study.ask(self.space)
            found.append((trial, tuple(trial.params[name] for name in self.names)))
        return found

    def tell(self, trial: Any, values: Sequence[float] | None) -> None:
        """What came of a trial: its objectives, or that it was given up."""
        if values is None:
            self.study.tell(trial, state=self.optuna.trial.TrialState.PRUNED)
        else:
            self.study.tell(trial, list(values))

    def _sampler(self, kind: str, seed: int) -> Any:
        samplers = self.optuna.samplers
        if kind == "tpe":
            return samplers.TPESampler(seed=seed, constant_liar=True, multivariate=True)
        return samplers.NSGAIISampler(seed=seed) if kind == "nsga2" else samplers.RandomSampler(seed=seed)
