"""What is measured: sensors, their messages, their faults, the perception instruments."""
