"""A virtual robot controller: a virtual robot behind the sockets of a real controller.

It reads the config files that are shipped for EthernetKRL, and nothing of the client that speaks to it.
"""
