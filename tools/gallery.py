"""Makes a page of everything that ships: scenarios, a patient, studies and diagnoses, with pictures and commands.

    python tools/gallery.py                       # build/gallery/index.html; `make gallery` does the same
    python tools/gallery.py --only ribs backlash  # a part of it
    python tools/gallery.py --pictures            # and docs/images of reports and films, from the same plans

Commands run as a reader would type them, and what they wrote is kept: a second run makes only what is missing, or
whose scenario, study or robot changed. Numbers come from the files that the commands wrote. Pictures are taken from the
pages by a browser where there is one (Chromium); without one plans are drawn by `ctrplan render`, others stay without.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import html
import json
import math
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))

from browser import Browser, chromium  # noqa: E402

from ctrplan.reports.html_page import POLICY, STYLE  # noqa: E402
from ctrplan.reports.words import millimetres  # noqa: E402

SCENARIOS = ROOT / "scenarios"
GUIDE = ROOT / "docs" / "guides" / "plan_for_your_robot.md"  # whose robot is diagnosed
ROBOT = re.compile(r'^```toml title="my_robot.toml"\n(.*?)^```$', re.M | re.S)
COUNT = 300  # targets of reach maps: a picture needs no more
STUDIES = {  # what is changed so that each takes a minute or so
    "reach_airway": ["--set", f"targets.count={COUNT}"],
    "reach_ventricle": ["--set", f"targets.count={COUNT}"],
    "entry_ventricle": ["--set", "targets.count=2", "--set", "bases.patch.radius_mm=1.5"],
    "friction_ventricle": [],
}
HIDDEN = {  # what the pretended robot has, and the model of the file lacks
    "joint_scale": ["effects.joint_scale.theta_2=0.05"],
    "backlash": ["effects.backlash.theta_2_deg=8"],
    "tip_load": ["effects.tip_load.force_x_N=0.06"],
    "ovality": ["effects.ovality.cos_2=0.25"],
}
NOISE = "\n[measurement]\nposition_sigma_mm = 0.3\ntangent_sigma_deg = 0.4\n"
CONFIGURATIONS, SIGMA_M, SIGMA_RAD = 30, 0.3e-3, math.radians(0.4)
BACK_M = (-0.048, -0.016)  # where the inner tube's base stands, as in the guide
SIZE = (640, 400)
SCREEN = {"width": 1100, "height": 900, "deviceScaleFactor": 1, "mobile": False}


@dataclass(frozen=True)
class Entry:
    """A card of the page: what it is, how it is made, and where its page and its numbers are."""

    kind: str
    name: str
    commands: tuple[str, ...]  # as a reader types them in the tree
    page: Path
    numbers: Callable[[], list[tuple[str, str]]]
    title: str = ""


class NotMadeError(Exception):
    """A command that ended without an answer; its last line says why."""


def program(*arguments: str, cwd: Path = ROOT) -> None:
    """Runs ctrplan of this environment. Raises NotMadeError with what it printed last."""
    command = [sys.executable, "-m", "ctrplan", *arguments]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)})
    if done.returncode not in (0, 3):
        raise NotMadeError(done.stderr.strip().splitlines()[-1] if done.stderr.strip() else f"exit {done.returncode}")


def kept(folder: Path, sources: list[Path], make: Callable[[], None]) -> None:
    """Makes what is in a folder unless it was made of the same sources."""
    said = hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()
    mark = folder / ".made_of"
    if mark.is_file() and mark.read_text() == said:
        return
    print(f"{folder.name} ...", flush=True)
    try:
        make()
    except NotMadeError as error:
        print(f"{folder.name}: {error}", file=sys.stderr)
        return
    mark.write_text(said)


def shown(path: Path) -> str:
    """A path as a reader in the tree types it."""
    return str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else str(path)


def scenarios(out: Path, wanted: Callable[[str], bool]) -> Iterator[Entry]:
    """A plan of every scenario."""
    for file in sorted(SCENARIOS.glob("*.toml")):
        if not wanted(file.stem):
            continue
        folder = out / "plans" / file.stem
        kept(folder, [file], lambda file=file, folder=folder: program("plan", str(file), "-o", str(folder)))  # type: ignore[misc]
        commands = (f"ctrplan plan {shown(file)} -o {file.stem}", f"ctrplan view {shown(file)}")
        yield Entry("Scenarios", file.stem, commands, folder / "report.html", lambda f=folder: of_plan(f))  # type: ignore[misc]


def of_plan(folder: Path) -> list[tuple[str, str]]:
    """Numbers of a written plan."""
    plan = json.loads((folder / "plan.json").read_text())
    certificate = plan["certificate"]
    arrival = certificate.get("arrival")
    rows = [("arrival", f"{millimetres(arrival['error_m'])} from the target")] if arrival else []
    rows.append(("worst case at the goal", millimetres(certificate["goal_bound_m"])))
    if certificate["min_clearance_m"] is not None and math.isfinite(certificate["min_clearance_m"]):
        rows.append(("certified clearance", f"{millimetres(certificate['min_clearance_m'])} beyond the margins"))
    return [*rows, ("duration", f"{plan['trajectory']['duration_s']:.3g} s in {len(plan['legs'])} legs")]


def patients(out: Path, wanted: Callable[[str], bool]) -> Iterator[Entry]:
    """The patient of our own, from its scan to a plan."""
    if not wanted("lungs"):
        return
    scan, folder = out / "lungs", out / "case"

    def make() -> None:
        scan.mkdir(parents=True, exist_ok=True)
        subprocess.run([sys.executable, str(SCENARIOS / "make_scan.py"), str(scan)], check=True, capture_output=True)
        program("case", str(scan), "-o", str(folder), "--quiet")

    kept(folder, [SCENARIOS / "make_scan.py"], make)
    commands = ("python scenarios/make_scan.py lungs", "ctrplan case lungs -o case")
    title = "a patient: airway, artery, target and entry as 3D Slicer writes them"
    yield Entry("Patients", "lungs", commands, folder / "plan" / "report.html", lambda: of_plan(folder / "plan"), title)


def studies(out: Path, wanted: Callable[[str], bool]) -> Iterator[Entry]:
    """Shipped studies, smaller."""
    for name, changes in STUDIES.items():
        if not wanted(name):
            continue
        file, folder = SCENARIOS / "studies" / f"{name}.toml", out / "studies" / name

        def make(file: Path = file, folder: Path = folder, changes: list[str] = changes) -> None:
            shutil.rmtree(folder, ignore_errors=True)
            program("study", str(file), "-o", str(folder), "--quiet", "--allow-outside", *changes)

        kept(folder, [file], make)
        yield Entry(
            "Studies",
            name,
            (f"ctrplan study {shown(file)} -o {name} {' '.join(changes)}".rstrip(),),
            folder / "report.html",
            lambda folder=folder: of_study(folder),  # type: ignore[misc]
        )


def of_study(folder: Path) -> list[tuple[str, str]]:
    """How many tasks, and the middle of the numbers that studies are judged by."""
    import ctrplan

    table = ctrplan.load_study(folder)
    rows = [("tasks", f"{len(table):,}, {100 * table.done.mean():.3g} % with an answer")]
    for name in ("worst_mm", "bound_mm", "robust_mm"):
        if name in table.columns and np.isfinite(values := np.asarray(table[name], dtype=float)).any():
            rows.append((name.replace("_", " "), f"{np.nanmedian(values[np.isfinite(values)]):.2g} in the middle"))
    return rows


def diagnoses(out: Path, wanted: Callable[[str], bool]) -> Iterator[Entry]:
    """The guide's pair of tubes with one hidden effect each, measured with a tracker's noise."""
    for name, hidden in HIDDEN.items():
        if not wanted(name):
            continue
        folder = out / "diagnoses" / name
        kept(folder, [GUIDE], lambda folder=folder, hidden=hidden: pretend(folder, hidden))  # type: ignore[misc]
        set_up = " ".join(f"--set {key}" for key in hidden)
        commands = (
            f"ctrplan simulate robot.toml commanded.csv -o pretended {set_up}",
            "ctrplan diagnose robot.toml measurements.csv -o diagnosis",
        )
        page = folder / "diagnosis" / "report.html"
        title = f"hidden: {', '.join(hidden)}"
        yield Entry("Diagnoses", name, commands, page, lambda f=folder: of_diagnosis(f), title)  # type: ignore[misc]


def pretend(folder: Path, hidden: list[str]) -> None:
    """Commands, tips with the effect and the tracker's noise, and what is found in them."""
    folder.mkdir(parents=True, exist_ok=True)
    robot = ROBOT.search(GUIDE.read_text(encoding="utf-8"))
    assert robot is not None
    (folder / "robot.toml").write_text(robot[1] + NOISE, encoding="utf-8")
    joints, draw = ["sequence", "theta_1_rad", "theta_2_rad", "l_1_m", "l_2_m"], random.Random(1)
    rows = list[list[float]]()
    for number in range(CONFIGURATIONS):
        outer, inner, back = (
            draw.uniform(-math.pi, math.pi),
            draw.uniform(-math.pi, math.pi),
            draw.uniform(*BACK_M),
        )
        for side in (-1, 1):
            run = 2 * number + (side > 0)
            rows += [[run, outer, inner + side * math.pi / 2, 0, back], [run, outer, inner, 0, back]]
    with (folder / "commanded.csv").open("w", newline="") as file:
        csv.writer(file).writerows([joints, *rows])
    changes = [part for key in hidden for part in ("--set", key)]
    program("simulate", "robot.toml", "commanded.csv", "-o", "pretended", *changes, cwd=folder)
    tips, noise = np.genfromtxt(folder / "pretended" / "poses.csv", delimiter=",", names=True), np.random.default_rng(0)
    pose = ["x_m", "y_m", "z_m", "tx", "ty", "tz"]
    stem = "measured_" if f"measured_{pose[0]}" in (tips.dtype.names or ()) else ""
    with (folder / "measurements.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([*joints, *pose])
        for k, (row, tip) in enumerate(zip(rows, tips, strict=True)):
            place = np.array([tip[stem + name] for name in pose[:3]]) + noise.normal(0, SIGMA_M, 3)
            along = np.array([tip[stem + name] for name in pose[3:]])
            along = along + np.cross(noise.normal(0, SIGMA_RAD, 3), along)
            writer.writerow([*row, *([*place, *along / np.linalg.norm(along)] if k % 2 else [""] * 6)])
    program("diagnose", "robot.toml", "measurements.csv", "-o", "diagnosis", "--quiet", cwd=folder)


def of_diagnosis(folder: Path) -> list[tuple[str, str]]:
    """The verdict and the gap."""
    said = json.loads((folder / "diagnosis" / "diagnosis.json").read_text())
    names = ", ".join(effect["name"] for effect in said["effects"]) or "none"
    gap = said["gap"]
    before, after, noise = (f"{gap[key]:.2g} mm" for key in ("before_rms_mm", "after_rms_mm", "noise_floor_mm"))
    closed = f"{before} off before, {after} after, noise {noise}"
    return [("verdict", f"{said['verdict'].replace('_', ' ')}: {names}"), ("poses kept aside", closed)]


SECTIONS = (scenarios, patients, studies, diagnoses)
MIDDLE = """(() => { const time = document.getElementById('time');
  if (time) { time.value = Math.round(SHARE * time.max); time.dispatchEvent(new Event('input')); } return true; })()"""
STANDS = "document.readyState === 'complete' && document.querySelector('.main-svg, canvas')"


def photographed(entries: list[Entry], out: Path, share: float = 0.8) -> dict[str, Path]:
    """A picture of the first figure of each page, plans late in their motion."""
    pictures = {entry.name: out / "pictures" / f"{entry.name}.png" for entry in entries}
    (out / "pictures").mkdir(parents=True, exist_ok=True)
    if chromium() is None:
        for entry in entries:
            if (plan := entry.page.parent / "plan.json").is_file():
                size = f"{SIZE[0]}x{SIZE[1]}"
                program("render", str(plan), "-o", str(pictures[entry.name]), "--size", size, "--allow-outside")
        return {name: path for name, path in pictures.items() if path.is_file()}
    with tempfile.TemporaryDirectory() as profile, Browser(Path(profile)) as browser:
        width, height = SIZE
        browser.send("Emulation.setDeviceMetricsOverride", **SCREEN)
        for entry in entries:
            photograph(browser, entry.page, pictures[entry.name], share, (width, height))
    return pictures


def photograph(browser: Any, page: Path, picture: Path, share: float, size: tuple[int, int]) -> None:
    """The scene of a page, or its first figure, so many pixels wide."""
    import base64

    browser.open(page.resolve().as_uri())
    browser.wait_for(STANDS)
    browser.run(MIDDLE.replace("SHARE", str(share)))
    browser.run("document.querySelectorAll('.modebar-container').forEach((bar) => bar.remove())")
    browser.run("new Promise((done) => setTimeout(() => done(true), 900))")
    box = json.loads(
        browser.run(
            "(() => { const at = (document.querySelector('.scene') || document.querySelector('.plot'))"
            ".getBoundingClientRect(); return JSON.stringify([at.x, at.y + scrollY, at.width, at.height]); })()"
        )
    )
    x, y, width, height = box
    clip = {"x": x, "y": y, "width": width, "height": height, "scale": size[0] / width}
    answer = browser.send("Page.captureScreenshot", format="png", captureBeyondViewport=True, clip=clip)
    picture.write_bytes(base64.b64decode(answer["data"]))


CARDS = """.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(340px, 100%), 1fr)); gap: 18px; }
.card { background: #fff; border-radius: 8px; overflow: hidden; display: flex; flex-direction: column; }
.card img { width: 100%; aspect-ratio: 16 / 9; object-fit: cover; background: #fff; display: block; }
.card img.whole { object-fit: contain; }
.card > div { padding: 12px 16px 14px; } .card h3 { margin: 0 0 4px; }
.card pre { white-space: pre-wrap; margin: 10px 0 0;
  background: #f4f6f8; border-radius: 6px; padding: 8px 10px; font-size: 0.78rem; overflow-wrap: anywhere; }
.card table { font-size: 0.88rem; } .card td { padding: 3px 10px 3px 0; } h2 { margin: 26px 0 10px; }"""


def page_of(entries: list[Entry], pictures: dict[str, Path], out: Path) -> str:
    """The whole page; pages and pictures lie beside it."""
    parts = []
    for kind in dict.fromkeys(entry.kind for entry in entries):
        cards = "".join(card(entry, pictures.get(entry.name), out) for entry in entries if entry.kind == kind)
        parts.append(f'<h2>{kind}</h2><div class="cards">{cards}</div>')
    policy = POLICY.replace("img-src data: blob:", "img-src 'self' data: file:")
    head = f'<meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="{policy}">'
    head += '<meta name="viewport" content="width=device-width, initial-scale=1"><title>ctrplan: gallery</title>'
    intro = "Everything that ships, made by the commands below each picture. A click opens the page that they wrote."
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head>{head}<style>{STYLE}{CARDS}</style></head><body><main>'
        f'<p class="kicker">ctrplan</p><h1>Gallery</h1><p>{intro}</p>{"".join(parts)}</main></body></html>\n'
    )


def card(entry: Entry, picture: Path | None, out: Path) -> str:
    """A picture that leads to the page, numbers, commands."""
    page = entry.page.relative_to(out).as_posix()
    rows = "".join(
        f'<tr><td class="key">{html.escape(a)}</td><td>{html.escape(b)}</td></tr>' for a, b in entry.numbers()
    )
    name = html.escape(entry.name.replace("_", " "))
    whole = ' class="whole"' if entry.kind == "Diagnoses" or entry.name.startswith("friction") else ""
    image = f'<img src="{picture.relative_to(out).as_posix()}" alt="{name}" loading="lazy"{whole}>' if picture else ""
    title = f'<p class="quiet small">{html.escape(entry.title)}</p>' if entry.title else ""
    commands = html.escape("\n".join(entry.commands))
    return (
        f'<div class="card"><a href="{page}">{image}</a><div><h3><a href="{page}">{name}</a></h3>{title}'
        f"<table><tbody>{rows}</tbody></table><pre>{commands}</pre></div></div>"
    )


IMAGES = ROOT / "docs" / "images"
DOCUMENTED = {  # pictures of documents that are made of plans of the gallery: arguments of `ctrplan render`
    "render_side.png": ("plans/airway", ["--camera", "side"]),
    "render_inside.png": ("plans/airway", ["--camera", "inside"]),
    "case_side.png": ("case/plan", ["--camera", "side"]),
    "case_inside.png": ("case/plan", ["--camera", "inside"]),
}


def pictures_of_documents(out: Path) -> None:
    """Renews docs/images of films and of the report."""
    for name, (folder, camera) in DOCUMENTED.items():
        if (out / folder / "plan.json").is_file():
            plan = str(out / folder / "plan.json")
            program("render", plan, "-o", str(IMAGES / name), "--quiet", "--allow-outside", *camera)
            in_few_colours(IMAGES / name)
    report = out / "plans" / "ribs" / "report.html"
    if chromium() is not None and report.is_file():
        with tempfile.TemporaryDirectory() as profile, Browser(Path(profile)) as browser:
            browser.send(
                "Emulation.setDeviceMetricsOverride", width=1100, height=900, deviceScaleFactor=1, mobile=False
            )
            photograph(browser, report, IMAGES / "report.png", 0.8, (960, 540))
        in_few_colours(IMAGES / "report.png")


def in_few_colours(file: Path) -> None:
    """Makes a picture small enough for a repository."""
    with Image.open(file) as picture:
        picture.convert("RGB").quantize(96).save(file, optimize=True)


def main() -> None:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "build" / "gallery")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="of what to show; default: all")
    parser.add_argument("--pictures", action="store_true", help="renew docs/images as well")
    arguments = parser.parse_args()
    out = arguments.output.resolve()
    sections = (section(out, lambda name: not arguments.only or name in arguments.only) for section in SECTIONS)
    entries = [entry for section in sections for entry in section if entry.page.is_file()]
    if missing := set(arguments.only) - {entry.name for entry in entries}:
        raise SystemExit(f"gallery: nothing is called {', '.join(sorted(missing))}, or it was not made")
    pictures = photographed(entries, out)
    (out / "index.html").write_text(page_of(entries, pictures, out), encoding="utf-8")
    if arguments.pictures:
        pictures_of_documents(out)
    print(f"open {out / 'index.html'}")


if __name__ == "__main__":
    main()
