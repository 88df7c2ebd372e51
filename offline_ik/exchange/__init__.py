"""Messages of the line protocol: words of requests, sessions, and the links to a robot."""
