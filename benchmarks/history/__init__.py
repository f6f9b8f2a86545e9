"""Times of ten tasks over the history of the project, by airspeed velocity (`asv.conf.json`)."""
