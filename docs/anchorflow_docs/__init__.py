"""What the documentation site is made with: reference pages, pictures, checks of what was built."""
