"""A calibration put to use: corrected wrenches, and the contact wrench without the tool."""
