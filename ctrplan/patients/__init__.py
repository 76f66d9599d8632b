"""A patient's case: from scans and points to a certified plan, step by step, each step's result a file to be edited.

`ctrplan.case` is the public function; docs/case.md shows the files.
"""
