"""Agents at the other end of a link: reached, fed, watched over, and held to account."""
