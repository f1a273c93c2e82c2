"""Charts below a track: GeoJSON features, or raster tiles of a folder or an MBTiles file, about the origin of a log."""
