"""Pictures before anything is known of light: resampling, noise, blurs, the subject, which belong together."""
