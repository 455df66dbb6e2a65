"""Devices whose protocols are those of other people's libraries: object servers, registers and frames are not ours."""
