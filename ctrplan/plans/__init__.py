"""Plans as values: legs, their certificate, the trajectory that plays them, plan.json, times along the way.

`planning` makes plans, `reports` draws them, `files` reads them back and `audit` judges them.
"""
