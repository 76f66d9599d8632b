"""`ctrplan.plan_many`: one plan for each of many scenarios, on processes of this machine or anybody's executor."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import Executor
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from ctrplan.base.arguments import EXECUTOR, PROGRESS, SEARCH_TIME, SEED, Made, checked, require
from ctrplan.base.long_work import one_core
from ctrplan.errors import CtrplanError, InputError, NoAnswerError
from ctrplan.planning.planner import plan
from ctrplan.plans.plan import Plan
from ctrplan.studies.child_process import ChildExecutor

if TYPE_CHECKING:
    from ctrplan.base.long_work import Progress
    from ctrplan.scenario.scenario import Scenario

SCENARIO = Made("Scenario")


@checked(seed=SEED, time_s=SEARCH_TIME, executor=EXECUTOR, progress=PROGRESS)
def plan_many(
    scenarios: Iterable[Scenario],
    *,
    seed: int = 0,
    time_s: float | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> list[Plan | CtrplanError]:
    """A plan for each scenario in their order, or the error that says why there is none; see `ctrplan.plan`.

    Each is done on one thread by `executor`, which has the interface of concurrent.futures, by default by as many
    processes as there are cores. `progress` is told the finished share. Raises InputError for what is no scenario.
    """
    asked = list(scenarios)
    for k, scenario in enumerate(asked):
        require(f"scenarios[{k}]", scenario, SCENARIO)
    with ExitStack() as stack:
        chosen = executor or stack.enter_context(ChildExecutor())
        futures = [_submitted(chosen, scenario, seed, time_s) for scenario in asked]
        stack.callback(lambda: [future.cancel() for future in futures])
        results = []
        for future in futures:
            results.append(_result(future))
            if progress is not None:
                progress(len(results) / len(futures))
    return results


def _submitted(executor: Executor, scenario: Scenario, seed: int, time_s: float | None) -> Any:
    try:
        return executor.submit(_plan, scenario, seed, time_s)
    except RuntimeError as error:  # of all executors of concurrent.futures
        raise InputError(f"takes no tasks ({error})", key="executor", value=executor) from error


def _result(future: Any) -> Plan | CtrplanError:
    try:
        result: Plan = future.result()
        return result
    except CtrplanError as error:
        return error
    except Exception as error:  # of the process that should have planned
        return NoAnswerError(f"no plan: {' '.join(str(error).split()) or type(error).__name__}")


def _plan(scenario: Scenario, seed: int, time_s: float | None) -> Plan:
    with one_core():
        return plan(scenario, seed=seed, time_s=time_s)
