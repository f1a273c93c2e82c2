"""The wire: the XITL dialect, its codec, and the transports."""
