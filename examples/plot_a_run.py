# %% [markdown]
# Simulate a run, read its recording and plot it. Run it as a script, or cell by cell in an editor that knows `# %%`.
#
#     pip install matplotlib
#     python examples/plot_a_run.py

# %% Simulate: the mission of the `sitl` profile in more wind than usual
import matplotlib.pyplot as plt

import xitl

result = xitl.simulate(
    "sitl", seed=7, overrides={"environment.wind.mean_mps": 6}, out="runs/plot-a-run", overwrite=True
)
mission = result.summary["mission"]
print(f"{mission['waypoints_reached']} of {mission['waypoints_total']} waypoints")
print(f"cross-track RMS {mission['cross_track_rms_m']:.2f} m")

# %% Read: every topic is a table, every field an array with the unit that the log names
with result.open_log() as log:
    truth, wind = log["/truth/state"], log["/environment"]
    true_ned_m = truth["position_ned_m"]  # (N, 3)
    time_s = truth.stamp_ns * 1e-9
    speed_mps = (truth["velocity_ned_mps"][:, :2] ** 2).sum(axis=1) ** 0.5
    wind_mps = (wind["wind_ned_mps"][:, :2] ** 2).sum(axis=1) ** 0.5
    wind_time_s = wind.stamp_ns * 1e-9

# %% Plot: the path, and speed and wind over time
figure, (path, over_time) = plt.subplots(1, 2, figsize=(11, 5), layout="constrained")
path.plot(true_ned_m[:, 1], true_ned_m[:, 0], label="true path")
waypoints = xitl.load_profile("sitl").mission.waypoints_ned_m
path.plot([east for _, east in waypoints], [north for north, _ in waypoints], "k+", label="waypoints")
path.set(xlabel="east (m)", ylabel="north (m)", aspect="equal", title="Path")
path.legend()
over_time.plot(time_s, speed_mps, label="speed over ground")
over_time.plot(wind_time_s, wind_mps, alpha=0.6, label="wind speed")
over_time.set(xlabel="simulation time (s)", ylabel="m/s", title="Speed and wind")
over_time.legend()
figure.savefig("plot_a_run.png", dpi=120)

# %% Analyse: what `xitl logs analyze` finds in it, worst first
for found in xitl.analyze(result.recording).findings[:5]:
    print(found.finding.severity.name, found.finding.sentence)
