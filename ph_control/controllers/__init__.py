"""Controllers that take energy out: damping injection, absorbers, observers and passive LQG."""
