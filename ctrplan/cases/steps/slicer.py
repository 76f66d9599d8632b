"""Step 5: the plan as a scene of 3D Slicer."""

from __future__ import annotations

from ctrplan.cases.work import PLACED, PLAN, SLICER, Step, Work
from ctrplan.files.plan_file import load_plan
from ctrplan.files.slicer.slicer_space import SCENE, patient_frame
from ctrplan.storage.output_folder import output_folder, write_results

STEPS = 40  # poses of the motion


class SlicerStep(Step):
    """As `ctrplan export --to slicer` does."""

    name = "slicer"
    files = ()
    results = (f"{SLICER}/{SCENE}",)

    def made_from(self, work: Work) -> object:
        return work.state(f"{PLAN}/plan.json", f"{PLAN}/trajectory.csv")

    def make(self, work: Work) -> str:
        from ctrplan.reports.slicer_case.files import case_files  # surfaces take a second to import
        from ctrplan.reports.written_motion import written_motion

        folder = output_folder(str(work.file(SLICER)), [SCENE])
        written = load_plan(work.file(f"{PLAN}/plan.json"), work.scenario(PLACED))
        motion = written_motion(written, STEPS, lambda share: work.progress("solving", share))
        said = work.request.frame if written.scenario.frame is None else None  # of a scenario that people wrote
        files = case_files(motion, patient_frame(written.scenario, said))
        write_results(folder, files)
        return f"{len(files)} files for 3D Slicer, {len(motion.path)} poses"
