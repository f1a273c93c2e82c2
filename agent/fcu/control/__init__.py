"""LC and LA: guidance, control loops, manual input and the allocation to the propellers."""
