"""What a person does to a run as it goes on: actions, how they are carried out, and how they are given again."""
