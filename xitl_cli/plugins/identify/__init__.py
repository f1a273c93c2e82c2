"""System identification: the parameters of a vessel and of its sensors from logs.

command.py              the commands
recording.py            the motion and the commands of a run; log_recording.py and table_recording.py read them
windows.py              short windows, and their simulation in one batch
free_keys.py            keys of a vehicle as numbers without bounds
fit.py                  least squares over windows
prediction.py           errors of predictions, next to a linear model and persistence
identification.py       fit, test, advice, and inertia and damping with their errors; identification_page.py shows them
sensors.py              noise, biases and delays of sensors
"""
