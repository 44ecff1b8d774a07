"""Names that other programs rely on."""

from zoedepth.weights.tensors import DOMAIN, INPUT, STD, Exported


def test_names_of_inputs_and_outputs_are_those_of_the_documentation():
    """transformers calls them so, too; files of other versions have these names."""
    assert (INPUT, DOMAIN) == ("pixel_values", "domain")
    assert Exported._fields == ("predicted_depth", STD, "domain_logits") == ("predicted_depth", "std", "domain_logits")
