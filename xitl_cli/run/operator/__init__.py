"""Actions of a person during a run: their definition, their execution, and their replay."""
