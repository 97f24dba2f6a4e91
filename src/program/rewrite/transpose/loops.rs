//! Adjoints of functions with active loops, in which a value that varies changes. Such adjoints are computed in forward
//! mode, once for each real argument. Few functions have such loops, and these take few reals.

use crate::error::Result;
use crate::program::rewrite::function_builder::{FunctionBuilder, called, inner_blocks, real_literal};
use crate::program::rewrite::jvp::function::rewrite_function;
use crate::program::rewrite::jvp::rewriting::NewFunction;
use crate::program::rewrite::linear::read_by;
use crate::program::rewrite::rules::rule;
use crate::program::rewrite::transpose::emit::Emitter;
use crate::program::rewrite::transpose::forward;
use crate::program::rewrite::transpose::layout::add_chains;
use crate::program::rewrite::transpose::names::{FORWARD_NOTED, no_way_back};
use crate::program::rewrite::transpose::record::Record;
use crate::program::rewrite::transpose::transposer::{Activity, Transposed, Transposer, is_pointer};
use naga::{
    BinaryOperator, Block, Expression, Function, FunctionArgument, FunctionResult, Handle, Span, Statement,
    Type, TypeInner,
};
use std::collections::HashMap;

/// Where a real lies in a value.
type Chain = Vec<u32>;

impl Transposer<'_> {
    /// Both halves of a function with loops.
    pub(super) fn by_tangents(
        &mut self,
        function: Handle<Function>,
        mask: &[bool],
        activity: &Activity,
    ) -> Result<Transposed> {
        let old = &self.module.functions[function];
        let name = self.name(function);
        let is_value = |argument: &FunctionArgument| !is_pointer(&self.module.types[argument.ty].inner);
        if !old.arguments.iter().all(is_value) || self.reads_twins(function) {
            return Err(no_way_back(name));
        }
        self.ensure_tangents(function)?;
        let with_tangents = self.rewriting.functions[&function].with_tangents;
        let with_tangents = with_tangents.ok_or_else(|| no_way_back(name))?;
        let mut record = Record::default();
        for (value, expression) in old.expressions.iter() {
            if let Expression::FunctionArgument(index) = expression {
                record.values.insert(value, record.types.len() as u32);
                record.types.push(old.arguments[*index as usize].ty);
            }
        }
        let record_type = self.structure("Record", &record.types.clone())?;
        let mut back = Emitter::default();
        back.new.name = Some(format!("{name}_backward"));
        let argument = |back: &mut Emitter, name: &str, ty: Handle<Type>| {
            let index = back.new.arguments.len() as u32;
            back.new.arguments.push(FunctionArgument { name: Some(name.into()), ty, binding: None });
            back.append(Expression::FunctionArgument(index))
        };
        let result = old.result.as_ref().filter(|_| activity.varies).map(|result| result.ty);
        let adjoint = result.map(|ty| argument(&mut back, "adjoint", ty));
        let kept = argument(&mut back, "record", record_type);
        let mut values = Vec::new();
        for (index, of) in (0..).zip(&old.arguments) {
            let used = old
                .expressions
                .iter()
                .find(|(_, e)| matches!(e, Expression::FunctionArgument(i) if *i == index));
            let member = used.and_then(|(value, _)| record.values.get(&value));
            values.push(match member {
                Some(member) => back.now(Expression::AccessIndex { base: kept, index: *member }),
                None => back.append(Expression::ZeroValue(of.ty)),
            });
        }
        let (mut types, mut adjoints, mut members) = (Vec::new(), Vec::new(), vec![None; mask.len()]);
        for (index, (of, varies)) in old.arguments.iter().zip(mask).enumerate() {
            if !varies {
                continue;
            }
            let mut found = HashMap::new();
            for chain in self.used_chains(function, index as u32, of.ty) {
                let slope = self.slope(
                    &mut back,
                    function,
                    with_tangents,
                    &values,
                    (index, &chain),
                    result.zip(adjoint),
                )?;
                found.insert(chain, slope);
            }
            members[index] = Some(types.len() as u32);
            types.push(of.ty);
            adjoints.push(self.built(&mut back, of.ty, &mut Vec::new(), &found));
        }
        let ty = self.structure("Adjoints", &types)?;
        let value = back.now(Expression::Compose { ty, components: adjoints });
        back.body.push(Statement::Return { value: Some(value) }, Span::UNDEFINED);
        back.new.result = Some(FunctionResult { ty, binding: None });
        let forward = forward::write(self, function, &record, Some(record_type))?;
        let functions = &mut self.rewriting.new.functions;
        let forward = functions.append(forward, Span::UNDEFINED);
        let back = functions.append(back.finished(), Span::UNDEFINED);
        let varies = activity.varies;
        Ok(Transposed { forward, back, record: Some(record_type), adjoints: Some(ty), members, varies })
    }

    /// What the loss gains by a unit of one real of one argument.
    fn slope(
        &mut self,
        back: &mut Emitter,
        function: Handle<Function>,
        with_tangents: Handle<Function>,
        values: &[Handle<Expression>],
        (of, chain): (usize, &Chain),
        adjoint: Option<(Handle<Type>, Handle<Expression>)>,
    ) -> Result<Handle<Expression>> {
        let old = &self.module.functions[function];
        let one = back.append(real_literal(self.rewriting.real, 1.0));
        let noted = self.global(FORWARD_NOTED)?;
        let real = self.module.global_variables[noted].ty;
        let noted = back.append(Expression::GlobalVariable(noted));
        let zero = back.append(Expression::ZeroValue(real));
        back.body.push(Statement::Store { pointer: noted, value: zero }, Span::UNDEFINED);
        let mut arguments = Vec::new();
        for (index, (argument, value)) in old.arguments.iter().zip(values).enumerate() {
            arguments.push(*value);
            if self.rewriting.has_reals(argument.ty) {
                let mut seed = HashMap::new();
                if index == of {
                    seed.insert(chain.clone(), one);
                }
                arguments.push(self.built(back, argument.ty, &mut Vec::new(), &seed));
            }
        }
        let Some((ty, adjoint)) = adjoint else {
            let result = old.result.is_some().then(|| back.append(Expression::CallResult(with_tangents)));
            back.body.push(Statement::Call { function: with_tangents, arguments, result }, Span::UNDEFINED);
            return Ok(back.now(Expression::Load { pointer: noted }));
        };
        let found = back.call_now(with_tangents, arguments);
        let tangent = back.now(Expression::AccessIndex { base: found, index: 1 });
        let mut sum = back.now(Expression::Load { pointer: noted });
        let mut chains = Vec::new();
        add_chains(self.module, ty, self.rewriting.real, &mut Vec::new(), &mut chains);
        for chain in chains {
            let [left, right] = [tangent, adjoint].map(|base| {
                chain
                    .iter()
                    .fold(base, |base, index| back.now(Expression::AccessIndex { base, index: *index }))
            });
            let product = back.now(Expression::Binary { op: BinaryOperator::Multiply, left, right });
            sum = back.now(Expression::Binary { op: BinaryOperator::Add, left: sum, right: product });
        }
        Ok(sum)
    }

    /// A value of a type from its reals; what is missing is zero.
    fn built(
        &mut self,
        back: &mut Emitter,
        ty: Handle<Type>,
        at: &mut Chain,
        reals: &HashMap<Chain, Handle<Expression>>,
    ) -> Handle<Expression> {
        if let Some(real) = reals.get(at) {
            return *real;
        }
        if !reals.keys().any(|chain| chain.starts_with(at)) {
            return back.append(Expression::ZeroValue(ty));
        }
        let parts: Vec<Handle<Type>> = match self.rewriting.new.types[ty].inner.clone() {
            TypeInner::Struct { members, .. } => members.into_iter().map(|member| member.ty).collect(),
            TypeInner::Vector { size, scalar } => {
                let scalar = self.type_with(TypeInner::Scalar(scalar));
                vec![scalar; size as usize]
            }
            TypeInner::Array { base, size: naga::ArraySize::Constant(num), .. } => {
                vec![base; num.get() as usize]
            }
            _ => Vec::new(),
        };
        let mut components = Vec::new();
        for (index, part) in (0..).zip(parts) {
            at.push(index);
            components.push(self.built(back, part, at, reals));
            at.pop();
        }
        back.now(Expression::Compose { ty, components })
    }

    /// Where the reals lie in an argument that a function reads.
    fn used_chains(&self, function: Handle<Function>, argument: u32, ty: Handle<Type>) -> Vec<Chain> {
        let mut all = Vec::new();
        add_chains(self.module, ty, self.rewriting.real, &mut Vec::new(), &mut all);
        let mut used = Some(Vec::new());
        self.add_used(function, argument, &mut used);
        match used {
            Some(members) => all
                .into_iter()
                .filter(|chain| chain.first().is_some_and(|first| members.contains(first)))
                .collect(),
            None => all,
        }
    }

    /// Adds the members of an argument that a function reads; none if it reads the whole.
    fn add_used(&self, function: Handle<Function>, argument: u32, used: &mut Option<Vec<u32>>) {
        let old = &self.module.functions[function];
        let is_it = |e: &Expression| matches!(e, Expression::FunctionArgument(index) if *index == argument);
        let Some((value, _)) = old.expressions.iter().find(|(_, e)| is_it(e)) else { return };
        for (_, expression) in old.expressions.iter() {
            match expression {
                Expression::AccessIndex { base, index } if *base == value => {
                    used.iter_mut().for_each(|used| used.push(*index));
                }
                other if read_by(other).contains(&value) => *used = None,
                _ => {}
            }
        }
        self.add_used_by_calls(&old.body, value, used);
    }

    fn add_used_by_calls(&self, block: &Block, value: Handle<Expression>, used: &mut Option<Vec<u32>>) {
        for statement in block.iter() {
            match statement {
                Statement::Call { function, arguments, .. } => match rule(self.name(*function)) {
                    // What a rule says of a function does not follow from the function's text.
                    Some(rule) if rule.sees(arguments) == Some(value) => *used = None,
                    Some(_) => {}
                    None => {
                        for (index, _) in (0..).zip(arguments).filter(|(_, argument)| **argument == value) {
                            self.add_used(*function, index, used);
                        }
                    }
                },
                Statement::Store { value: stored, .. } if *stored == value => *used = None,
                Statement::Return { value: Some(returned) } if *returned == value => *used = None,
                _ => inner_blocks(statement).for_each(|block| self.add_used_by_calls(block, value, used)),
            }
        }
    }

    /// True if a function, or one that it calls, names a variable that has a twin. Such a variable holds numbers of the scene, or
    /// what an invocation keeps.
    fn reads_twins(&self, function: Handle<Function>) -> bool {
        let old = &self.module.functions[function];
        let reads = old.expressions.iter().any(|(_, expression)| match expression {
            Expression::GlobalVariable(variable) => self.twins.contains_key(variable),
            _ => false,
        });
        reads
            || called(&old.body)
                .into_iter()
                .any(|callee| rule(self.name(callee)).is_none() && self.reads_twins(callee))
    }

    /// Sees to it that a function, and all that it calls, has a half with tangents.
    fn ensure_tangents(&mut self, function: Handle<Function>) -> Result<()> {
        let known = self.rewriting.functions[&function];
        if known.with_tangents.is_some() || rule(self.name(function)).is_some() {
            return Ok(());
        }
        let old = &self.module.functions[function];
        for callee in called(&old.body) {
            self.ensure_tangents(callee)?;
        }
        if !self.rewriting.has_tangents(old) {
            return Ok(());
        }
        let info = &self.info()[function];
        let mut with_tangents = rewrite_function(&mut self.rewriting, old, info)?;
        with_tangents.name = Some(format!("{}_with_tangents", self.name(function)));
        let with_tangents = Some(self.rewriting.new.functions.append(with_tangents, Span::UNDEFINED));
        self.rewriting.functions.insert(function, NewFunction { with_tangents, ..known });
        Ok(())
    }
}
