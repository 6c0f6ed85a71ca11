"""Where the robots should go next."""
