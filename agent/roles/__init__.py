"""Roles of a node, and the ground stations and storage of the embedded autopilot."""
