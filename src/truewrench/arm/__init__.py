"""Arms: their joints, and what a log of joints says of the sensor."""
