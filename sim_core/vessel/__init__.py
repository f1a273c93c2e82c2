"""The vessel: hydrodynamics, buoyancy, propulsion and windage of N rigid bodies."""
