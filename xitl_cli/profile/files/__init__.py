"""Profiles as files: YAML with the origin of every value, composition, and names of the shipped profiles."""
