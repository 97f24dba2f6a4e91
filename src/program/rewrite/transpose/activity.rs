//! Which values of a function depend on a number by which a trace can be differentiated.

use crate::program::rewrite::function_builder::inner_blocks;
use crate::program::rewrite::linear::operands;
use crate::program::rewrite::rules::{Rule, rule};
use crate::program::rewrite::transpose::transposer::{Activity, Transposer, is_pointer};
use naga::{Block, Expression, Function, Handle, LocalVariable, Statement};
use std::collections::HashSet;

impl Transposer<'_> {
    /// What is known of a function whose arguments vary where `mask` says so.
    pub(super) fn activity(&mut self, function: Handle<Function>, mask: &[bool]) -> Activity {
        let key = (function, mask.to_vec());
        if let Some(known) = self.activities.get(&key) {
            return known.clone();
        }
        let old = &self.module.functions[function];
        let mut search = Search {
            shared: self,
            old,
            function,
            mask,
            found: Activity::default(),
            locals: HashSet::new(),
            results: HashSet::new(),
        };
        search.found.has_effects =
            old.arguments.iter().zip(mask).any(|(argument, varies)| {
                *varies && is_pointer(&search.shared.module.types[argument.ty].inner)
            });
        loop {
            let before = (search.found.varied.len(), search.locals.len(), search.results.len());
            search.block(&old.body);
            // What no statement computes: arguments, and pointers to variables.
            for (value, _) in old.expressions.iter() {
                search.varies(value);
            }
            if before == (search.found.varied.len(), search.locals.len(), search.results.len()) {
                break;
            }
        }
        let found = search.found;
        self.activities.insert(key, found.clone());
        found
    }

    /// Which arguments of a call vary.
    pub(super) fn mask(
        &self,
        caller: Handle<Function>,
        arguments: &[Handle<Expression>],
        varied: &HashSet<Handle<Expression>>,
    ) -> Vec<bool> {
        let of = |argument: &Handle<Expression>| {
            let inner = self.inner(caller, *argument);
            self.has_reals(inner) && (is_pointer(inner) || varied.contains(argument))
        };
        arguments.iter().map(of).collect()
    }
}

struct Search<'r, 'm> {
    shared: &'r mut Transposer<'m>,
    old: &'m Function,
    function: Handle<Function>,
    mask: &'r [bool],
    found: Activity,
    locals: HashSet<Handle<LocalVariable>>,
    results: HashSet<Handle<Expression>>,
}

impl Search<'_, '_> {
    fn block(&mut self, block: &Block) {
        block.iter().for_each(|statement| self.statement(statement));
    }

    fn statement(&mut self, statement: &Statement) {
        match statement {
            Statement::Emit(range) => range.clone().for_each(|value| {
                self.varies(value);
            }),
            Statement::Store { pointer, value } if self.varies(*value) => self.may_vary(*pointer),
            Statement::Return { value: Some(value) } => self.found.varies |= self.varies(*value),
            Statement::Call { function, arguments, result } => self.call(*function, arguments, *result),
            other => inner_blocks(other).for_each(|block| self.block(block)),
        }
    }

    fn call(
        &mut self,
        function: Handle<Function>,
        arguments: &[Handle<Expression>],
        result: Option<Handle<Expression>>,
    ) {
        arguments.iter().for_each(|argument| {
            self.varies(*argument);
        });
        let varies = match rule(self.shared.name(function)) {
            Some(rule) => {
                let varies = rule.sees(arguments).is_some_and(|argument| self.varies(argument));
                self.found.has_effects |= varies && rule == Rule::Note;
                varies && rule != Rule::Note
            }
            None => {
                let mask = self.shared.mask(self.function, arguments, &self.found.varied);
                for (argument, varies) in arguments.iter().zip(&mask) {
                    if *varies && is_pointer(self.shared.inner(self.function, *argument)) {
                        self.may_vary(*argument);
                    }
                }
                let of_call = self.shared.activity(function, &mask);
                self.found.has_effects |= of_call.has_effects;
                of_call.varies
            }
        };
        if let (true, Some(result)) = (varies, result) {
            self.results.insert(result);
            self.varies(result);
        }
    }

    /// Notes that the variable of a pointer varies.
    fn may_vary(&mut self, pointer: Handle<Expression>) {
        match &self.old.expressions[pointer] {
            Expression::LocalVariable(variable) => {
                self.locals.insert(*variable);
            }
            Expression::GlobalVariable(variable) => {
                self.found.has_effects |= self.shared.twins.contains_key(variable);
            }
            Expression::Access { base, .. } | Expression::AccessIndex { base, .. } => self.may_vary(*base),
            _ => {}
        }
    }

    /// True if a value varies, or the variable of a pointer.
    fn varies(&mut self, value: Handle<Expression>) -> bool {
        if self.found.varied.contains(&value) {
            return true;
        }
        if !self.shared.has_reals(self.shared.inner(self.function, value)) {
            return false;
        }
        let varies = match &self.old.expressions[value] {
            Expression::FunctionArgument(index) => self.mask[*index as usize],
            Expression::LocalVariable(variable) => self.locals.contains(variable),
            Expression::GlobalVariable(variable) => self.shared.twins.contains_key(variable),
            Expression::CallResult(_) => self.results.contains(&value),
            expression => operands(expression).into_iter().any(|operand| self.varies(operand)),
        };
        if varies {
            self.found.varied.insert(value);
        }
        varies
    }
}
