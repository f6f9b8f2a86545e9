"""Recordings and frequency responses as the fit takes them."""
