"""Published vessels by their authors' equations, integrated on their own: they import nothing of the project."""
