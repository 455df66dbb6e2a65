"""CANopen (CiA 301) behind a CAN adapter: the parts that the drivers of CANopen devices have in common."""
