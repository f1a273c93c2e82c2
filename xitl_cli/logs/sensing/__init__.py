"""What the analyses of sensors share: the series of one kind of sensor from any format, rest, spectra, settings.

columns → inertial, plain, fixes → rest, holding, noise, spectrum
"""
