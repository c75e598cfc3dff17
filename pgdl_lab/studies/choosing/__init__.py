"""The least model that meets a tolerance."""
