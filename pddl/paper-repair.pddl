;; paper-repair.pddl: the four repair actions of the paper (section IV-E), for comparison only.
;;
;; As published, not_on and not_running are predicates of their own. An action that adds a fact deletes
;; its opposite here; the release left both in the state. What it cannot know: that a driver must restart after
;; its device lost power, that a node rests on others, and which devices can be switched at all. It therefore
;; restarts what it need not and misses what it must; repair.pddl is the domain to use.
;;
;; Problems come from service/robomend/planning/problem.py, as for repair.pddl; facts that this domain does not
;; declare are left out. Costs are those of repair.pddl, so that plans of both compare.
;;
;; Source: the paper, section IV-E, and its open-source release (2012): the meaning of the actions, none of its text.

(define (domain paper-repair)
  (:requirements :strips :typing :action-costs)
  (:types component - object
          hardware node - component)
  (:predicates
    (bad ?c - component) (good ?c - component)
    (on ?h - hardware) (not_on ?h - hardware)
    (running ?n - node) (not_running ?n - node))
  (:functions (total-cost) - number)

  (:action power_up
    :parameters (?c - hardware)
    :precondition (and (not_on ?c) (bad ?c))
    :effect (and (on ?c) (not (not_on ?c)) (good ?c) (not (bad ?c)) (increase (total-cost) 10)))

  (:action shutdown
    :parameters (?c - hardware)
    :precondition (and (on ?c) (bad ?c))
    :effect (and (not_on ?c) (not (on ?c)) (increase (total-cost) 15)))

  (:action start_node
    :parameters (?c - node)
    :precondition (and (not_running ?c) (bad ?c))
    :effect (and (running ?c) (not (not_running ?c)) (good ?c) (not (bad ?c)) (increase (total-cost) 3)))

  (:action stop_node
    :parameters (?c - node)
    :precondition (and (running ?c) (bad ?c))
    :effect (and (not_running ?c) (not (running ?c)) (increase (total-cost) 1))))
