"""Programs for an arm that is not in service: settings, calibration and bench tests of its drives."""
