"""One run: the plant, the pilot behind its link, the clock that paces them, and what is kept of it.

profile -> world (vessel, surroundings, sensors)     world.py, sensing.py
        -> pilot (agent over a link, or none)        pilot.py, agent_pilot.py, agents/, ideal_pilot.py, track_pilot.py
        -> driver (who gives the orders)             driver.py, orders.py, *_driver.py
        -> loop (steps, exchange, recording)         loop.py, pace.py
        -> summary, run directory, live view         summary.py, directory.py, view.py
"""
