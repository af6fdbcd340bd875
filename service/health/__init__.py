"""Health of a running rig: a short experiment, compared with what its commissioning found. Pure, but for `files`."""
