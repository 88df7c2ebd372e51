"""What is said on the line: words of requests, sessions, and the links to a robot."""
