"""Many runs of a profile: a plan, its points, their runs on Dask, a table of what they say.

plan.py          PlanSpec (the file) -> CampaignPlan
base.py          the profile that runs begin with, and what a point makes of it
axes.py          axes -> RunPoint
expression.py    constraints and verdicts, read without eval
figures.py       figures of a summary
execution.py     one run as one subprocess within limits: RunTask -> Row
warden.py        program beside a worker: ends the runs of one that is gone
cluster.py       Dask: workers here or by address
results.py       CampaignFolder writes rows as they come; ResultTable reads them
engine.py        Campaign: asks for points, submits, collects. Campaign.submit(points) -> rows
search_spec.py   keys of searches and sensitivity -> Search
search.py        Search -> points, round by round -> SearchFinding
bisection.py     one axis; exploration.py: several
sensitivity.py   samples and indices
statistics.py    intervals, tests and estimates
compare.py       two campaigns, run by run
report.py        ResultTable -> sections; pictures.py: their plots
carry_out.py     a plan from its folder to its table
"""
