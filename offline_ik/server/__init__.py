"""The command server: the protocol's answers, and the connections that ask."""
