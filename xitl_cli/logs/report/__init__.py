"""Report of the analyses of some logs for terminal, program (JSON) and browser (HTML)."""
