"""Studies of a vessel and of the toolkit: the paper's experiments, standard manoeuvres, checks of a vessel's model."""
