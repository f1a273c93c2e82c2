"""The `xitl` command: composes `sim_core` and `agent`, runs, records and reports."""
