"""The command `xitl firmware`: download the firmware of other autopilots into the cache."""
