"""What surrounds the vessels: water, current, waves, wind. Null objects stand for what is absent."""
