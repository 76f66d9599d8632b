"""The search for a path. The only room that imports OMPL."""
