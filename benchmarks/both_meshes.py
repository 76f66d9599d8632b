"""Does a plan say the same clearances whichever mesh it is certified on? Shipped scenarios, both meshes.

python benchmarks/both_meshes.py [SCENARIO ...]
"""

from __future__ import annotations

import argparse
from pathlib import Path

from own_cache import use_own_cache

import ctrplan
from ctrplan.certificate.certificate import Certificate
from ctrplan.certificate.certify import certify

SCENARIOS = Path(__file__).resolve().parents[1] / "scenarios"
NAMES = ["airway", "heart_chamber", "ribs", "sinus", "ventricle", "vessel"]


def clearances_mm(certificate: Certificate) -> list[float]:
    """Of the frictionless robot, of the worst friction state found, and what is certified."""
    assert certificate.nominal is not None and certificate.closest is not None
    found = certificate.nominal.clearance_m, certificate.closest.clearance_m, certificate.min_clearance_m
    return [1e3 * value for value in found]


def main() -> None:
    use_own_cache()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenarios", nargs="*", default=NAMES, help=f"default: {', '.join(NAMES)}")
    print("| scenario | frictionless, mm: coarse, fine | any friction state | certified |\n|---|---|---|---|")
    for name in parser.parse_args().scenarios:
        plan = ctrplan.plan(ctrplan.load_scenario(SCENARIOS / f"{name}.toml"))
        both = [clearances_mm(certify(plan.scenario, plan.waypoints, accuracy=on)) for on in ("search", "certificate")]
        cells = [f"{coarse:.2f}, {fine:.2f}" for coarse, fine in zip(*both, strict=True)]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
