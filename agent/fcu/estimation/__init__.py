"""LS: the estimator and its parts."""
