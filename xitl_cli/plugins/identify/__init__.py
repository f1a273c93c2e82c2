"""System identification: the parameters of a vessel and of its sensors from logs."""
