"""What can be done with every combination of a study, a file each.

`[task] kind` of a study file names one; see `ctrplan.studies.study.task`.
"""
