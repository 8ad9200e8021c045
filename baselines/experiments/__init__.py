"""Tables and figures of the source, one short file each: mostly data (see `reproduction`)."""
