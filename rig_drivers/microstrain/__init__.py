"""MicroStrain (LORD) wireless nodes behind a base station on a serial port."""
