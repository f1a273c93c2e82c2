class IdealPilot:
    pass
