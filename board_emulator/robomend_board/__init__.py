"""The power board, emulated: a device to develop against, with loads and with faults on demand. See
docs/board.md.
"""
