"""The steps of a case, a file each; every step makes files from those of the step before."""
