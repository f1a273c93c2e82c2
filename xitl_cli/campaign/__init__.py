"""Many runs of a profile: a plan, its points, their runs on Dask, a table of what they say.

plan.py        PlanSpec (the file) -> CampaignPlan
axes.py        axes -> RunPoint
expression.py  constraints and verdicts, read without eval
figures.py     figures of a summary
execution.py   one run as one subprocess within limits: RunTask -> Row
warden.py      program beside a worker: ends the runs of one that is gone
cluster.py     Dask: workers here or by address
results.py     CampaignFolder writes rows as they come; ResultTable reads them
engine.py      Campaign: asks for points, submits, collects. Campaign.submit(points) -> rows
"""
