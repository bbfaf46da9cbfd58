"""Light before the sensor: apertures, lenses, point-spread functions, renderers."""
