"""Laws without a name: what virtual joints, devices, sensors and rigs may do that the catalogue does not have."""
