"""An experiment seen through a model: geometry and loads, the device's placement, the columns and values that fit."""
