"""The command `xitl logs`, on the library `xitl_cli.logs`."""
