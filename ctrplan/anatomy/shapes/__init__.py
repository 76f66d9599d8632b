"""The kinds of obstacles and lumens, one file each.

`[[anatomy]] kind` of a scenario names one; a new kind is a new file, see `ctrplan.anatomy.shape`.
"""
