"""Contact of the specimen with plates and indenters."""
