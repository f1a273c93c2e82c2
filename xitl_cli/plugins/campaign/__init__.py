"""Campaigns: a plan gives points, their runs on Dask give rows, and rows give a table and a report.

plan.py          PlanSpec (the file) -> CampaignPlan
base.py          the base profile of all runs, and the overrides of a point
axes.py          axes -> RunPoint
expression.py    constraints and verdicts, read without eval
figures.py       figures of a summary
execution.py     one run as one subprocess within limits: RunTask -> Row
warden.py        companion program of a worker: ends the runs of a dead worker
cluster.py       Dask: workers here or by address
results.py       CampaignFolder writes rows at once; ResultTable reads them
engine.py        Campaign: requests points, submits runs, collects rows; carry_out: plan and folder -> table
search_spec.py   keys of searches and sensitivity -> Search
search.py        Search -> points, round by round -> SearchFinding
bisection.py     one axis; exploration.py: several
sensitivity.py   samples and indices
statistics.py    intervals, tests and estimates
compare.py       two campaigns, run by run
report.py        ResultTable -> sections; pictures.py: their plots
estimate.py      wall time and disk space of a campaign
command.py       `xitl campaign`; api.py: `xitl.campaign`
"""
