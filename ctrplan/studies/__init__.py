"""Many runs: simulations along a path, sweeps, studies of thousands of tasks, designs.

Each runs on the processors of this machine; a study also on a cluster.
"""
