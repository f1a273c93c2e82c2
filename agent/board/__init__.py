"""What a board needs besides the agent: to install it, to keep it running, to say whether the board is fit for it."""
