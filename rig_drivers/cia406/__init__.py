"""CANopen encoders (CiA 406) behind an adapter: both pendulums and, optionally, the shaft."""
