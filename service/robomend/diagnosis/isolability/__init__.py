"""Isolability: which faults can be detected and told apart by the observables at hand, before one happens.

    Obs(F)   what the observables at hand may show while exactly the components of F are abnormal: the
             projections of the models of SD ∪ {AB(c) | c ∈ F} ∪ {¬AB(c) | c ∉ F}

    F is *detectable*              some o ∈ Obs(F) has F as a minimal diagnosis
    F can be *told from* G         some o ∈ Obs(F) has F as a minimal diagnosis, and G does not explain o
    … *always*                     every o of which F is a minimal diagnosis; otherwise *sometimes*
    F *cannot* be told from G      whatever F may show, G may show as well

So a pair is judged by what the engine would say of the observations that the fault can produce; docs/
isolability.md argues for it, and names the field's words. Reading order:

    comparing.py    signatures, exact and fast where rules are definite and each atom has one; a search,
                    exact for all other models (∃ observation, ∀ hidden values; by counterexamples)
    analysis.py     all faults against all; groups; what is asked and answered
    words.py        the answer in sentences, and what a rule could add
"""
