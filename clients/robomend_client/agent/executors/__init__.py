"""What an agent can do: executors by action and parameters, made from its file.

base.py        their shape, all kinds by name, the section `actions:` of the agent's file
supervised.py  start_node and stop_node of the agent's own processes
program.py     kind `process`: a program that is run to its end
systemd.py     kind `systemd`: units
usb.py         kind `reset_usb`: a USB device, as if it were unplugged and plugged in
               kind `ros_action` is bridges/ros1/actions.py
"""
