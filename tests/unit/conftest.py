"""Fixtures of all unit tests."""

from tests.installed_packages import install as install
