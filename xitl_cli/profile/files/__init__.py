"""Profiles as files: YAML with the place of every value, composition of several, names of the shipped ones."""
