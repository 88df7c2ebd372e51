"""A virtual robot controller: it plays a virtual robot over the sockets that a real one would have.

It reads the config files that are shipped for EthernetKRL, and nothing of the client that speaks to it.
"""
