"""How a product is refused."""


class ProductError(ValueError):
    """It cannot be made of what there is, or not so: one sentence that says what would be right."""
