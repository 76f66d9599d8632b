"""Many runs: simulations along a path, sweeps."""
