"""The command `xitl logs` and the analyses of logs, on the library `xitl_cli.logs`."""
