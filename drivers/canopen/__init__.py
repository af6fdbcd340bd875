"""CANopen: object dictionary and EDS, codec, driver."""
