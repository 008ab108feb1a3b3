"""E-puck robots in a walled arena: the model of the field's benchmark, and its missions."""
