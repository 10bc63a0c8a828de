"""How to cite capsbayes: the content of `CITATION.cff`, for pages."""

from __future__ import annotations

import capsbayes

MESSAGE = "If you use capsbayes, please cite it, and the article whose method it extends."
SOFTWARE = (
    f"The capsbayes developers. capsbayes, version {capsbayes.__version__}. Shear modulus and radius of liquid-core "
    "microcapsules from a picture, with honest credible intervals. MIT licence."
)
ARTICLE = (
    "Carlos Quesada, Claire Dupont, Pierre Villon and Anne-Virginie Salsac. Diffuse approximation for identification "
    "of the mechanical properties of microcapsules. Mathematics and Mechanics of Solids, 2021."
)
DOI = "10.1177/1081286520977602"
