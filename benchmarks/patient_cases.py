"""Public patients, by name: where their files lie, which structures count, from where and to what the robot goes.

Nothing of the data is here: every case names a public repository, which is cloned beside the others, and reads targets
and entries from its files where it has them. `docs/patients.md` has the licences.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

START = {  # tips behind the plate
    "lung_needle": {"advance all": -109, "translate inner": -80},
    "brain_cannula": {"advance all": -79, "translate inner": -50},
    "liver_needle": {"advance all": -159, "translate inner": -90},
    "three_tube_insertion": {"rotate middle": 180, "rotate inner": 90, "advance all": -149, "translate inner": -86.4},
}


@dataclass(frozen=True)
class Structure:
    """A part of the anatomy: a file and the rest of its `[[anatomy]]`."""

    file: str  # in the case's folder; several phases of one, separated by spaces
    role: str
    margin_mm: float
    more: str = ""  # further lines of TOML


@dataclass(frozen=True)
class Case:
    """A patient, a robot and a task; positions and directions in the files' frame."""

    name: str
    organ: str
    folder: str  # below the folder with the clones
    robot: str
    structures: tuple[Structure, ...]
    target: str | tuple[float, float, float]  # a file with three numbers, or the numbers (mm)
    entry: str | tuple[float, ...]  # a file with a 4 x 4 matrix whose z axis looks into the patient; or place and axis
    frame: str = "RAS"
    radius_mm: float = 5.0  # of the patch of entries
    cone_deg: float = 30.0
    tolerance_mm: float = 2.0
    lumens: tuple[str, ...] = field(default=())  # bodies in TOML that the robot may be in, too

    def target_mm(self, root: Path) -> np.ndarray:
        """(3,) in the frame of the case."""
        if isinstance(self.target, str):
            return np.loadtxt(root / self.folder / self.target).ravel()
        return np.array(self.target)

    def entry_mm(self, root: Path) -> tuple[np.ndarray, np.ndarray]:
        """(3,) place and (3,) unit direction."""
        if isinstance(self.entry, str):
            matrix = np.loadtxt(root / self.folder / self.entry)
            return matrix[:3, 3], matrix[:3, 2]
        place, away = np.array(self.entry[:3]), np.array(self.entry[3:])
        return place, away / np.linalg.norm(away)

    def scenario(self, root: Path, robots: Path) -> str:
        """The scenario's TOML, with paths of this machine."""
        place, direction = self.entry_mm(root)
        start = "\n".join(f'"{joint}" = {value}' for joint, value in self._start(robots))
        parts = "\n".join([*(self._part(root, part) for part in self.structures), *self.lumens])
        return f"""name = "{self.name}"
frame = "{self.frame}"
robot = "{robots / self.robot}.toml"
[base]
position_mm = {place.round(3).tolist()}
direction = {direction.round(6).tolist()}
[start]
{start}
[goal]
tip_mm = {self.target_mm(root).round(3).tolist()}
tolerance_mm = {self.tolerance_mm}
{parts}
[planner]
time_s = 5
"""

    def _start(self, robots: Path) -> Iterator[tuple[str, float]]:
        names = re.findall(r'^name = "(.+)"$', (robots / f"{self.robot}.toml").read_text(), re.MULTILINE)[1:]
        for name in names:
            yield name, START[self.robot].get(name, 0)

    def _part(self, root: Path, part: Structure) -> str:
        paths = [str(root / self.folder / name) for name in part.file.split("|")]
        is_volume = paths[0].endswith(".nii.gz")
        kind = 'kind = "volume"\nlabel = 1' if is_volume else f'kind = "mesh"\nunit = "mm"\nframe = "{self.frame}"'
        files = f'file = "{paths[0]}"' if len(paths) == 1 else f"files = {paths}"
        return f'[[anatomy]]\n{kind}\n{files}\nrole = "{part.role}"\nmargin_mm = {part.margin_mm}\n{part.more}'


def _avoid(*files: str, margin_mm: float) -> tuple[Structure, ...]:
    return tuple(Structure(file, "avoid", margin_mm) for file in files)


def _brains() -> Iterator[Case]:
    """Burr hole to a globus pallidus, around vessels and ventricles."""
    for k in range(1, 6):
        yield Case(
            name=f"brain {k}",
            organ="brain",
            folder=f"Med-RAD/Data/Brain/Patient{k}",
            robot="brain_cannula",
            structures=_avoid("vessels.nii.gz", "ventricles.nii.gz", margin_mm=0.5),
            target="target1.txt",
            entry="start1.txt",
        )


def _livers() -> Iterator[Case]:
    """Through the skin to a nodule, around arteries and veins."""
    tasks = [
        (1, "target", "start1", "hepaticArtery hepaticVein portalVein"),
        (2, "target1", "target1_start1", "hepaticArtery hepaticVein portalVein"),
        (2, "target2", "target2_start1", "hepaticArtery hepaticVein portalVein"),
        (3, "target1", "nodule1_start1", "hepaticartery hepaticvein portalvein"),
        (3, "target2", "nodule2_start1", "hepaticartery hepaticvein portalvein"),
        (4, "target", "start1", "hepaticArtery hepaticVein portalVein"),
        (5, "target1", "target1_start1", "hepaticArtery hepaticVein portalVein"),
        (5, "target2", "target2_start1", "hepaticArtery hepaticVein portalVein"),
    ]
    for patient, target, entry, vessels in tasks:
        yield Case(
            name=f"liver {patient}" + (f".{target[-1]}" if target[-1].isdigit() else ""),
            organ="liver",
            folder=f"Med-RAD/Data/Liver/Patient{patient}",
            robot="liver_needle",
            structures=_avoid(*(f"{name}.nii.gz" for name in vessels.split()), margin_mm=0.5),
            target=f"{target}.txt",
            entry=f"{entry}.txt",
            radius_mm=8.0,
        )


def _lungs() -> Iterator[Case]:
    """Through the wall of a bronchus to a nodule, around vessels."""
    for patient, entry in ((1, 2), (2, 1), (3, 4), (4, 2), (5, 1)):
        yield Case(
            name=f"lung {patient}",
            organ="lung",
            folder=f"Med-RAD/Data/Lungs/TumorTargetEnvironments/Patient{patient}",
            robot="lung_needle",
            structures=_avoid("vessels.nii.gz", margin_mm=0.3),
            target="target.txt",
            entry=f"start{entry}.txt",
        )


CASES = {case.name: case for case in [*_brains(), *_livers(), *_lungs()]}
