"""Reinforcement learning: the vessel of a profile as an environment with Gymnasium's interface.

api.py           xitl.make_env, xitl.make_vec_env
environment.py   VesselEnv and VesselVectorEnv: the only file that imports Gymnasium
episodes.py      Episodes: observations, rewards, ends and restarts of a batch
batch.py         VesselBatch: the simulation of N vessels in blocks of rows
vessels.py       Vessels: the arrays that rewards and observations are computed from
observation.py   parts of an observation, by name, with their limits
sensors.py       the profile's sensors for a block of vessels
top_view.py      the picture of `render`
"""
