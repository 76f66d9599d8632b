"""A scripted module for 3D Slicer that loads a folder which `ctrplan export --to slicer` wrote.

Not tested inside 3D Slicer: it was written from Slicer's documentation, and what is tested (tests/reports/
test_slicer_extra.py) is only that it compiles, and that its choice of files fits the folders. To use it, add the folder
it lies in to Edit > Application Settings > Modules > Additional module paths.
"""

import json
import re
from pathlib import Path

try:  # elsewhere than in Slicer, the functions that need no Slicer can still be used
    import ctk
    import qt
    import slicer
    from slicer.ScriptedLoadableModule import ScriptedLoadableModule, ScriptedLoadableModuleWidget
except ImportError:
    ctk = qt = slicer = None
    ScriptedLoadableModule = ScriptedLoadableModuleWidget = object

SCENE = "scene.mrml"
VOLUMES = (".nrrd", ".nii", ".nii.gz", ".mha", ".mhd")


class CtrplanCase(ScriptedLoadableModule):
    """What the list of modules says."""

    def __init__(self, parent):
        """Fills in the module's own page."""
        super().__init__(parent)
        parent.title = "ctrplan case"
        parent.categories = ["Planning"]
        parent.dependencies = []
        parent.contributors = ["ctrplan"]
        parent.helpText = "Loads a plan of a concentric tube robot that ctrplan export --to slicer wrote."
        parent.acknowledgementText = ""


class CtrplanCaseWidget(ScriptedLoadableModuleWidget):
    """A folder to choose, a button, and what was loaded."""

    def setup(self):
        """Builds the panel."""
        super().setup()
        box = ctk.ctkCollapsibleButton()
        box.text = "Case"
        self.layout.addWidget(box)
        form = qt.QFormLayout(box)
        self.folder = ctk.ctkPathLineEdit()
        self.folder.filters = ctk.ctkPathLineEdit.Dirs
        form.addRow("Folder:", self.folder)
        self.button = qt.QPushButton("Load")
        form.addRow(self.button)
        self.text = qt.QLabel()
        self.text.wordWrap = True
        form.addRow(self.text)
        self.button.connect("clicked(bool)", self.on_load)
        self.layout.addStretch(1)

    def on_load(self, *_):
        """Loads the folder; what is wrong is said in the panel."""
        try:
            self.text.text = load_case(self.folder.currentPath)
        except (OSError, ValueError, RuntimeError) as error:
            self.text.text = f"Not loaded: {error}"


def load_case(folder):
    """Adds a case to the scene that is open, volumes of the folder included; returns a sentence about it."""
    place = Path(folder)
    problems = faults(place)
    if problems:
        raise ValueError(problems[0])
    for volume in volumes(place):
        slicer.util.loadVolume(str(volume))
    if not slicer.util.loadScene(str(place / SCENE)):  # added to what is open
        raise RuntimeError(f"{place / SCENE} could not be loaded")
    seconds = play()
    slicer.util.resetThreeDViews()
    return f"{title(place)} The motion of {seconds:.1f} s plays in the Sequences module."


def play():
    """Shows the beginning of the motion; returns how long it takes [s]."""
    browsers = slicer.util.getNodesByClass("vtkMRMLSequenceBrowserNode")
    last = 0.0
    for browser in browsers:
        sequence = browser.GetMasterSequenceNode()
        if sequence is not None and sequence.GetNumberOfDataNodes():
            last = max(last, float(sequence.GetNthIndexValue(sequence.GetNumberOfDataNodes() - 1)))
        browser.SetSelectedItemNumber(0)
    return last


def faults(folder):
    """Sentences about what is missing in a folder; empty for a whole case."""
    if not (folder / SCENE).is_file():
        return [f"{folder} holds no {SCENE}: choose a folder that ctrplan export --to slicer wrote."]
    named = re.findall(r'fileName="([^"]*)"', (folder / SCENE).read_text(encoding="utf-8"))
    return [f"{folder / name} is missing." for name in named if not (folder / name).is_file()]


def volumes(folder):
    """Images that were put into the folder, to be shown with the plan."""
    return sorted(path for path in folder.iterdir() if path.name.lower().endswith(VOLUMES))


def title(folder):
    """Targets of a case in a sentence."""
    (markup,) = json.loads((folder / "targets.mrk.json").read_text(encoding="utf-8"))["markups"]
    names = [point["label"] for point in markup["controlPoints"]]
    return f"From {names[0]} to {', '.join(names[1:])}."
