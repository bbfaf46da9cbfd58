"""The app: a page in the browser that measures, and leads through a calibration."""
