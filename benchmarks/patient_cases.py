"""Public patients, by name: where their files lie, which structures count, from where and to what the robot goes.

Nothing of the data is here: every case names a public repository, which is cloned beside the others, and reads targets
and entries from its files where it has them. `docs/patients.md` has the licences.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROBOTS = Path(__file__).resolve().parents[1] / "scenarios" / "robots"
Place = str | tuple[float, float, float]


@dataclass(frozen=True)
class PublicCase:
    """A patient, a robot and a task."""

    name: str
    organ: str
    folder: str  # below the folder with the clones
    robot: str
    target: Place  # a file with three numbers, or the numbers (mm)
    entry: Place  # files, apart by spaces, with a 4 x 4 matrix whose last column counts, or the numbers (mm)
    avoid: tuple[str, ...] = ()
    lumen: tuple[str, ...] = ()
    phases: tuple[str, ...] = ()  # files of one structure that moves, of which a lumen or obstacle is the first
    frame: str = "RAS"
    more: tuple[str, ...] = ()  # further options

    def command(self, root: Path) -> list[str]:
        """Arguments of ctrplan, without the output folder."""
        files = [str(root / self.folder / file) for file in (*self.lumen, *self.avoid) if file not in self.phases]
        roles = [word for file in self.lumen for word in ("--lumen", file)]
        roles += [word for file in self.avoid for word in ("--avoid", file)]
        places = ["--target", *_place(root / self.folder, self.target)]
        for entry in self.entry.split() if isinstance(self.entry, str) else [self.entry]:
            places += ["--entry", *_place(root / self.folder, entry)]
        robot = ["--robot", str(ROBOTS / f"{self.robot}.toml")]
        moving = ["--phases", *(str(root / self.folder / file) for file in self.phases)] if self.phases else []
        return ["case", *files, *moving, *roles, *places, "--frame", self.frame, *robot, *self.more]


def _place(folder: Path, place: Place) -> Sequence[str]:
    if not isinstance(place, str):
        return [f"{x:g}" for x in place]
    rows = [list(map(float, line.split())) for line in (folder / place).read_text().splitlines() if line.strip()]
    numbers = [row[3] for row in rows[:3]] if len(rows) == 4 else [row[0] for row in rows]
    return [f"{x:.3f}" for x in numbers]


def _brains() -> Iterator[PublicCase]:
    """Burr hole to a globus pallidus, around vessels and ventricles."""
    for k in range(1, 6):
        yield PublicCase(
            name=f"brain {k}",
            organ="brain",
            folder=f"Med-RAD/Data/Brain/Patient{k}",
            robot="brain_cannula",
            target="target1.txt",
            entry="start1.txt",
            avoid=("vessels.nii.gz", "ventricles.nii.gz"),
            more=("--tolerance-mm", "1"),
        )


def _livers() -> Iterator[PublicCase]:
    """Through the skin to a nodule, around arteries and veins."""
    tasks = [
        (1, "target", "start1"),
        (2, "target1", "target1_start1"),
        (2, "target2", "target2_start1"),
        (3, "target1", "nodule1_start1"),
        (4, "target", "start1"),
        (5, "target1", "target1_start1"),
    ]
    for patient, target, entry in tasks:
        vessels = ("hepaticArtery", "hepaticVein", "portalVein")
        yield PublicCase(
            name=f"liver {patient}" + (f".{target[-1]}" if target[-1].isdigit() else ""),
            organ="liver",
            folder=f"Med-RAD/Data/Liver/Patient{patient}",
            robot="liver_needle",
            target=f"{target}.txt",
            entry=f"{entry}.txt",
            avoid=tuple(f"{name.lower() if patient == 3 else name}.nii.gz" for name in vessels),
            more=("--tolerance-mm", "2", "--radius-mm", "8"),
        )


def _lungs() -> Iterator[PublicCase]:
    """Through the wall of a bronchus to a nodule, around vessels."""
    for patient, entries in ((1, (1, 3)), (2, (1, 3)), (3, (4, 5)), (4, (2, 4)), (5, (1, 2))):
        yield PublicCase(
            name=f"lung {patient}",
            organ="lung",
            folder=f"Med-RAD/Data/Lungs/TumorTargetEnvironments/Patient{patient}",
            robot="lung_needle",
            target="target.txt",
            entry=" ".join(f"start{entry}.txt" for entry in entries),
            avoid=("vessels.nii.gz",),
            more=("--tolerance-mm", "2", "--margin-mm", "0.1", "--cone-deg", "30", "--candidates", "256"),
        )


def _ventricles() -> Iterator[PublicCase]:
    """A burr hole in front of the coronal suture and a sheath into a lateral ventricle, to its body."""
    places = {
        1: ((-90, -117, 168), (-102.5, -72.6, 198.3)),
        2: ((-94, -130, 111), (-107.3, -87.1, 142.3)),
        5: ((-82, -117, 101), (-68.7, -78.5, 134.4)),
    }
    for patient, (target, entry) in places.items():
        yield PublicCase(
            name=f"ventricle {patient}",
            organ="brain",
            folder=f"Med-RAD/Data/Brain/Patient{patient}",
            robot="brain_cannula",
            target=target,
            entry=entry,
            lumen=("ventricles.nii.gz",),
            avoid=("vessels.nii.gz",),
            more=("--margin-mm", "0.2", "--sheath-mm", "3", "--radius-mm", "1", "--cone-deg", "3"),
        )


def _airways() -> Iterator[PublicCase]:
    """From a bronchoscope in the trachea down a main bronchus, between its walls."""
    nodules, breathing = "TumorTargetEnvironments/Patient", "RespiratoryMotionEnvironments/Patient"
    tasks = [
        ("airway 1 left", f"{nodules}1/bronchialTree", (-25.1, 121.5, 1258.6), (-0.9, 136.4, 1312.5)),
        ("airway 1 right", f"{nodules}1/bronchialTree", (18.9, 129.3, 1258.6), (-0.3, 135.9, 1309.7)),
        ("airway 3 left", f"{nodules}3/bronchialTree", (-12, 125.3, -157.6), (7.4, 135.9, -110)),
        ("airway 3 right", f"{nodules}3/bronchialTree", (26.3, 129, -159.7), (6.5, 136.3, -107.9)),
        ("airway 7 right", f"{breathing}2/BronchialTree", (43.6, -161.9, -157.6), (26.8, -152.8, -97.4)),
    ]
    for name, file, target, entry in tasks:
        folder, tree = f"Med-RAD/Data/Lungs/{file}.nii.gz".rsplit("/", 1)
        yield PublicCase(
            name=name,
            organ="lung",
            folder=folder,
            robot="three_tube_insertion",
            target=target,
            entry=entry,
            lumen=(tree,),
            more=("--margin-mm", "0.1", "--tolerance-mm", "2", "--cone-deg", "45", "--candidates", "256"),
        )


def _throats() -> Iterator[PublicCase]:
    """From a laryngoscope's end through the larynx to its floor or into the trachea, between its walls."""
    tasks = [
        ("throat 4074", "TCGA-BA-4074", (17.5, 216, 166), (17.1, 209.4, 200)),
        ("throat 4077", "TCGA-BA-4077", (2.5, 137.6, -455), (6, 150.6, -383)),
        ("throat 5558", "TCGA-BA-5558", (-0.2, 151, 46), (-1.5, 147.5, 93)),
        ("throat 5331", "TCGA-CQ-5331", (-3.2, 35, -479), (-1.2, 44.3, -431)),
        ("throat 7872", "TCGA-BB-7872", (213, 198, -428), (217, 190, -376)),
    ]
    for name, folder, target, entry in tasks:
        yield PublicCase(
            name=name,
            organ="larynx",
            folder=f"SPIE-2021/anatomical-models/{folder}",
            robot="three_tube_insertion",
            target=target,
            entry=entry,
            avoid=("tissue.stl",),
            more=("--file-frame", "RAS", "--margin-mm", "0.5", "--cone-deg", "40", "--candidates", "256"),
        )


def _hearts() -> Iterator[PublicCase]:
    """Through the mitral valve of a left atrium to the mouths of two pulmonary veins."""
    for name, target in (("atrium far vein", (226.5, 174.6, 121)), ("atrium near vein", (224.5, 159, 99.5))):
        yield PublicCase(
            name=name,
            organ="heart",
            folder="VaMPy/models/atrium",
            robot="three_tube_insertion",
            target=target,
            entry=(216.8, 189.2, 75),
            lumen=("atrium.vtp",),
            more=(
                "--repair",
                "caps",
                "--file-frame",
                "RAS",
                "--margin-mm",
                "0.5",
                "--radius-mm",
                "4",
                "--cone-deg",
                "30",
            ),
        )


def _moving_hearts() -> Iterator[PublicCase]:
    """As before, of an atrium that beats: four of its twenty phases, at most 1.2 mm from one to the next."""
    yield PublicCase(
        name="moving atrium",
        organ="heart",
        folder="VaMPy/models/moving_atrium/model_moved",
        robot="three_tube_insertion",
        target=(25, -162.7, -1085),
        entry=(-15.3, -151.7, -1089.7),
        lumen=("model_moved_00.vtp",),
        phases=tuple(f"model_moved_{k:02}.vtp" for k in (0, 1, 2, 5)),
        more=("--repair", "caps", "--file-frame", "RAS", "--margin-mm", "0.5", "--radius-mm", "4", "--cone-deg", "30"),
    )


KINDS = (_brains, _ventricles, _livers, _lungs, _airways, _throats, _hearts, _moving_hearts)
CASES = {case.name: case for cases in KINDS for case in cases()}
PAGE = (  # those of docs/patients.md
    *(
        "brain 1",
        "brain 2",
        "brain 3",
        "brain 4",
        "ventricle 1",
        "liver 2.1",
        "liver 3.1",
        "liver 5.1",
        "lung 2",
        "lung 5",
    ),
    *("airway 3 right", "throat 4077", "throat 5558", "atrium far vein", "atrium near vein", "moving atrium"),
)
