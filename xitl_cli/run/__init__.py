"""One run: the plant, the pilot behind its link, the clock that paces them, and what is kept of it.

profile -> plant (vessel, surroundings, sensors)     plant.py, injection.py
        -> pilot (agent over a link, or none)        pilot.py, agent_pilot.py, peer.py
        -> driver (who gives the orders)             driver.py
        -> loop (steps, exchange, recording)         loop.py, pace.py
        -> summary, run directory, live view         summary.py, directory.py, view.py
"""
