"""The commands of ``zswarm-ot``, one file each. They import what they need when they are called: a command starts at once."""
