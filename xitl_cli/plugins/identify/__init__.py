"""System identification: the parameters of a vessel and of its sensors from logs.

vessel_command.py sensors_command.py   the commands
recording.py            the motion and the commands of a run; log_recording.py and table_recording.py read them
windows.py              short windows, and their simulation in one batch
free_keys.py            keys of a vehicle as numbers without bounds
fit.py                  least squares over windows
figures.py              inertia and damping with their errors
prediction.py           errors of predictions, next to a linear model and persistence
identification.py       the whole of it: fit, test, advice; identification_page.py shows it
sensors.py              noise, biases and delays of sensors
"""
