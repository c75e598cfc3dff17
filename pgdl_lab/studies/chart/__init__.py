"""Error against time: methods of a scene beside a converged reference."""
