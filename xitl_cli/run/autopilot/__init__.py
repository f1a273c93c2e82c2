"""The host's side of another autopilot behind a bridge: started, prepared, timed, its log collected."""
