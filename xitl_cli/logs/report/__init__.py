"""What the analyses found about some logs, for a terminal, for a program and for a browser."""
