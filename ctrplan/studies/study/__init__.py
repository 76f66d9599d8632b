"""Studies: thousands of independent tasks over one robot or scenario, on this machine or a cluster.

`ctrplan.Study` is the public class; docs/studies.md has the file's keys.
"""
