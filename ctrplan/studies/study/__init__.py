"""Studies: thousands of independent tasks over one robot or scenario, on this machine or a cluster."""
