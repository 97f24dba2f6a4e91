//! Writes the half of a function that goes back: from adjoints of what it gave to adjoints of what it took.
//!
//! Statements are taken from the last to the first. Values of the way forward come from the record. The recorded
//! condition says which branch was taken. Loops in which a value that varies changes have no way back here: `loops` has
//! one.

use crate::error::{Error, Result};
use crate::program::rewrite::function_builder::{FunctionBuilder, inner_blocks};
use crate::program::rewrite::linear::Linearise;
use crate::program::rewrite::rules::{Rule, rule};
use crate::program::rewrite::transpose::adjoint::Adjoint;
use crate::program::rewrite::transpose::forward;
use crate::program::rewrite::transpose::names::{ADJOINT_OF, no_way_back};
use crate::program::rewrite::transpose::record::{Record, key_of};
use crate::program::rewrite::transpose::transposer::{Activity, Transposed, Transposer, is_pointer};
use naga::{
    Block, Expression, Function, FunctionArgument, Handle, LocalVariable, Span, Statement, SwitchCase, Type,
    TypeInner,
};
use std::collections::HashMap;

type Value = Handle<Expression>;

/// The block of the function's body, to which its arguments belong.
pub(super) const ROOT: usize = 1;

impl Transposer<'_> {
    /// Both halves of a function whose arguments vary where `mask` says so.
    pub(super) fn transposed(&mut self, function: Handle<Function>, mask: &[bool]) -> Result<Transposed> {
        let key = (function, mask.to_vec());
        if let Some(known) = self.transposed.get(&key) {
            return Ok(known.clone());
        }
        let activity = self.activity(function, mask);
        let made = match Back::new(self, function, activity.clone()).write(mask) {
            Err(Error::NoWayBack(name)) if name == self.name(function) => {
                self.by_tangents(function, mask, &activity)?
            }
            made => made?,
        };
        self.transposed.insert(key, made.clone());
        Ok(made)
    }

    /// Writes the function `NAME_back` that a shader declares: it goes the way of the function `NAME` forward, then back.
    /// Takes the arguments of `NAME`, then pointers to the adjoints of those that hold reals, then the adjoint of the result.
    pub(super) fn both_ways(&mut self, declared: Handle<Function>, name: &str) -> Result<Function> {
        let function = self.function(name)?;
        let old = &self.module.functions[function];
        let mask: Vec<bool> = old.arguments.iter().map(|a| self.rewriting.has_reals(a.ty)).collect();
        let made = self.transposed(function, &mask)?;
        let mut back = Back::new(self, declared, Activity::default());
        back.new.name = back.old.name.clone();
        let mut out = Block::new();
        let num = back.old.arguments.len() as u32;
        let mut forward: Vec<Value> =
            (0..num).map(|index| back.append(Expression::FunctionArgument(index))).collect();
        back.new.arguments = back.old.arguments.clone();
        let mut adjoints = forward.split_off(mask.len()).into_iter();
        let mut next =
            || adjoints.next().ok_or_else(|| Error::Internal(format!("{name}_back has too few arguments")));
        let (mut given, mut taken) = (Vec::new(), Vec::new());
        for (index, argument) in old.arguments.iter().enumerate().filter(|(index, _)| mask[*index]) {
            let pointer = next()?;
            match is_pointer(&back.shared.module.types[argument.ty].inner) {
                true => given.push(pointer),
                false => taken.push((index, argument.ty, pointer)),
            }
        }
        if made.varies {
            given.push(next()?);
        }
        let record = made.record.map(|ty| {
            let variable = LocalVariable { name: Some("record".into()), ty, init: None };
            let variable = back.new.local_variables.append(variable, Span::UNDEFINED);
            back.append(Expression::LocalVariable(variable))
        });
        forward.extend(record);
        match old.result {
            Some(_) => {
                back.call_for_result(made.forward, forward, &mut out);
            }
            None => {
                let call = Statement::Call { function: made.forward, arguments: forward, result: None };
                out.push(call, Span::UNDEFINED);
            }
        }
        if let Some(pointer) = record {
            given.push(back.emit(Expression::Load { pointer }, &mut out));
        }
        if made.adjoints.is_none() {
            let call = Statement::Call { function: made.back, arguments: given, result: None };
            out.push(call, Span::UNDEFINED);
        } else {
            let found = back.call_for_result(made.back, given, &mut out);
            for (member, ty, pointer) in taken {
                let Some(index) = made.members[member] else { continue };
                let adjoint = Adjoint::whole(back.part(found, index, &mut out));
                back.add_to_memory(pointer, ty, adjoint, &mut out);
            }
        }
        back.new.body = out;
        Ok(back.new)
    }
}

/// A half as it is written.
pub(super) struct Back<'r, 'm> {
    pub(super) shared: &'r mut Transposer<'m>,
    pub(super) function: Handle<Function>,
    pub(super) old: &'m Function,
    pub(super) activity: Activity,
    pub(super) new: Function,
    /// Where the record is read.
    pub(super) prologue: Block,
    pub(super) record: Record,
    pub(super) record_argument: u32,
    /// Values of the way forward.
    pub(super) known: HashMap<Value, Value>,
    /// Pointers to adjoints, by the number of the argument that points to the reals.
    pub(super) pointers: HashMap<u32, Value>,
    pub(super) locals: HashMap<Handle<LocalVariable>, Handle<LocalVariable>>,
    pub(super) adjoints: HashMap<Value, Adjoint>,
    /// Adjoints that come from other blocks than the value's own.
    pub(super) variables: HashMap<Value, Handle<LocalVariable>>,
    /// The block in which a value is computed.
    pub(super) homes: HashMap<Value, usize>,
    pub(super) block: usize,
    pub(super) num_blocks: usize,
    /// The adjoint of the result.
    pub(super) result: Option<Value>,
}

impl FunctionBuilder for Back<'_, '_> {
    fn new_function(&mut self) -> &mut Function {
        &mut self.new
    }
}

impl<'r, 'm> Back<'r, 'm> {
    pub(super) fn new(
        shared: &'r mut Transposer<'m>,
        function: Handle<Function>,
        activity: Activity,
    ) -> Self {
        let old = &shared.module.functions[function];
        let name = format!("{}_backward", old.name.as_deref().unwrap_or_default());
        Back {
            shared,
            function,
            old,
            activity,
            new: Function { name: Some(name), ..Default::default() },
            prologue: Block::new(),
            record: Record::default(),
            record_argument: 0,
            known: HashMap::new(),
            pointers: HashMap::new(),
            locals: HashMap::new(),
            adjoints: HashMap::new(),
            variables: HashMap::new(),
            homes: HashMap::new(),
            block: 0,
            num_blocks: 0,
            result: None,
        }
    }

    pub(super) fn write(mut self, mask: &[bool]) -> Result<Transposed> {
        for (index, (argument, varies)) in (0..).zip(self.old.arguments.iter().zip(mask)) {
            if *varies && is_pointer(&self.shared.module.types[argument.ty].inner) {
                let name = argument.name.as_ref().map(|name| format!("{name}_adjoint"));
                let pointer = self.argument(name, argument.ty);
                self.pointers.insert(index, pointer);
            }
        }
        let varies = self.activity.varies;
        if let (true, Some(result)) = (varies, &self.old.result) {
            self.result = Some(self.argument(Some("adjoint".into()), result.ty));
        }
        self.record_argument = self.new.arguments.len() as u32;
        let statements: Vec<&Statement> = self.old.body.iter().collect();
        let mut body = Block::new();
        let (mut types, mut values, mut members) = (Vec::new(), Vec::new(), vec![None; mask.len()]);
        self.list(&statements, &mut body)?;
        self.block = ROOT;
        for (index, (argument, varies)) in (0..).zip(self.old.arguments.iter().zip(mask)) {
            let old = self.old_argument(index);
            let (Some(old), true, false) = (old, *varies, self.pointers.contains_key(&index)) else {
                continue;
            };
            let adjoint = self.take(old, argument.ty, &mut body);
            if let Some(value) = self.materialised(&adjoint, argument.ty, &mut body) {
                members[index as usize] = Some(types.len() as u32);
                types.push(argument.ty);
                values.push(value);
            }
        }
        let adjoints = match types.is_empty() {
            true => None,
            false => Some(self.shared.structure("Adjoints", &types)?),
        };
        let value = adjoints.map(|ty| self.emit(Expression::Compose { ty, components: values }, &mut body));
        body.push(Statement::Return { value }, Span::UNDEFINED);
        self.new.result = adjoints.map(|ty| naga::FunctionResult { ty, binding: None });
        let mut all = std::mem::take(&mut self.prologue);
        all.append(&mut body);
        self.new.body = all;
        let record = match self.record.types.is_empty() {
            true => None,
            false => Some(self.shared.structure("Record", &self.record.types.clone())?),
        };
        if let Some(ty) = record {
            self.argument(Some("record".into()), ty);
        }
        let forward = forward::write(self.shared, self.function, &self.record, record)?;
        let functions = &mut self.shared.rewriting.new.functions;
        let forward = functions.append(forward, Span::UNDEFINED);
        let back = functions.append(std::mem::take(&mut self.new), Span::UNDEFINED);
        Ok(Transposed { forward, back, record, adjoints, members, varies })
    }

    pub(super) fn argument(&mut self, name: Option<String>, ty: Handle<Type>) -> Value {
        let index = self.new.arguments.len() as u32;
        self.new.arguments.push(FunctionArgument { name, ty, binding: None });
        self.append(Expression::FunctionArgument(index))
    }

    /// The old value of an argument, if the function uses it.
    pub(super) fn old_argument(&self, index: u32) -> Option<Value> {
        let mut all = self.old.expressions.iter();
        all.find(|(_, expression)| matches!(expression, Expression::FunctionArgument(i) if *i == index))
            .map(|(handle, _)| handle)
    }

    pub(super) fn varies(&self, old: Value) -> bool {
        self.activity.varied.contains(&old)
    }

    pub(super) fn is_pointer(&self, old: Value) -> bool {
        is_pointer(self.shared.inner(self.function, old))
    }

    pub(super) fn inner(&self, ty: Handle<Type>) -> &TypeInner {
        &self.shared.rewriting.new.types[ty].inner
    }

    pub(super) fn real_type(&mut self) -> Handle<Type> {
        let real = self.shared.rewriting.real;
        self.shared.type_with(TypeInner::Scalar(real))
    }

    /// The value that an old expression had on the way forward.
    pub(super) fn value(&mut self, old: Value) -> Value {
        if let Some(known) = self.known.get(&old) {
            return *known;
        }
        let new = match &self.old.expressions[old] {
            expression @ (Expression::Literal(_) | Expression::Constant(_) | Expression::ZeroValue(_)) => {
                self.append(expression.clone())
            }
            _ => {
                let ty = self.type_of(old);
                let member = self.record.types.len() as u32;
                self.record.types.push(ty);
                self.record.values.insert(old, member);
                self.member_of_record(member)
            }
        };
        self.known.insert(old, new);
        new
    }

    pub(super) fn member_of_record(&mut self, index: u32) -> Value {
        let base = self.append(Expression::FunctionArgument(self.record_argument));
        let mut prologue = std::mem::take(&mut self.prologue);
        let member = self.emit(Expression::AccessIndex { base, index }, &mut prologue);
        self.prologue = prologue;
        member
    }

    /// Goes back over statements, which end where the function does. What follows a branch that may return is written once in
    /// each branch, and only one of these copies runs.
    ///
    /// The block that computes a value is the value's home. An adjoint is an expression as long as all uses of the value stand
    /// in that block. Uses in inner blocks add to a variable, which `take` adds where the value is computed. No block runs twice, so
    /// the variable is never set back.
    pub(super) fn list(&mut self, statements: &[&'m Statement], out: &mut Block) -> Result<()> {
        let statements = flat(statements);
        self.num_blocks += 1;
        let own = self.num_blocks;
        let outer = std::mem::replace(&mut self.block, own);
        let end = statements.iter().position(|statement| returns(statement)).unwrap_or(statements.len());
        for statement in &statements[..end] {
            match statement {
                Statement::Emit(range) => range.clone().for_each(|value| {
                    self.homes.insert(value, own);
                }),
                Statement::Call { result: Some(result), .. } => {
                    self.homes.insert(*result, own);
                }
                _ => {}
            }
        }
        if let Some(last) = statements.get(end) {
            let after = &statements[end + 1..];
            match last {
                Statement::Return { value } => {
                    if let (Some(value), Some(result)) = (value, self.result) {
                        self.contribute_whole(*value, result, out);
                    }
                }
                other => self.branches(other, after, out)?,
            }
        }
        for statement in statements[..end].iter().rev() {
            self.statement(statement, out)?;
        }
        self.block = outer;
        Ok(())
    }

    pub(super) fn statement(&mut self, statement: &'m Statement, out: &mut Block) -> Result<()> {
        match statement {
            Statement::Emit(range) => {
                let values: Vec<Value> = range.clone().collect();
                for old in values.into_iter().rev() {
                    if self.varies(old) && !self.is_pointer(old) {
                        self.expression(old, out)?;
                    }
                }
            }
            Statement::Store { pointer, value } => {
                if let (true, Some(pointer)) = (self.varies(*pointer), self.adjoint_pointer(*pointer, out)) {
                    let adjoint = self.emit(Expression::Load { pointer }, out);
                    let ty = self.type_of(*value);
                    let zero = self.append(Expression::ZeroValue(ty));
                    out.push(Statement::Store { pointer, value: zero }, Span::UNDEFINED);
                    self.contribute_whole(*value, adjoint, out);
                }
            }
            Statement::Call { function, arguments, result } => {
                self.call(statement, *function, arguments, *result, out)?;
            }
            Statement::Loop { .. } if self.is_active(statement) => {
                return Err(no_way_back(self.shared.name(self.function)));
            }
            Statement::If { .. } | Statement::Switch { .. } => self.branches(statement, &[], out)?,
            // Other statements use no value that varies.
            _ => {}
        }
        Ok(())
    }

    /// Goes back over the branches of a statement, each of which goes on with the same statements.
    pub(super) fn branches(
        &mut self,
        statement: &'m Statement,
        after: &[&'m Statement],
        out: &mut Block,
    ) -> Result<()> {
        let back = |this: &mut Self, block: &'m Block| -> Result<Block> {
            let mut statements: Vec<&Statement> = block.iter().collect();
            let is_break = |statement: &&Statement| matches!(statement, Statement::Break);
            if statements.last().is_some_and(is_break) {
                statements.pop();
            }
            if statements.iter().any(|statement| breaks(statement)) {
                return Err(no_way_back(this.shared.name(this.function)));
            }
            statements.extend(after);
            let mut out = Block::new();
            this.list(&statements, &mut out)?;
            Ok(out)
        };
        match statement {
            Statement::If { condition, accept, reject } => {
                let (accept, reject) = (back(self, accept)?, back(self, reject)?);
                if !(accept.is_empty() && reject.is_empty()) {
                    let condition = self.value(*condition);
                    out.push(Statement::If { condition, accept, reject }, Span::UNDEFINED);
                }
            }
            Statement::Switch { selector, cases } => {
                let mut new = Vec::new();
                for case in cases {
                    if case.fall_through && !case.body.is_empty() {
                        return Err(no_way_back(self.shared.name(self.function)));
                    }
                    let body = if case.fall_through { Block::new() } else { back(self, &case.body)? };
                    new.push(SwitchCase { body, ..case.clone() });
                }
                if new.iter().any(|case| !case.body.is_empty()) {
                    let selector = self.value(*selector);
                    out.push(Statement::Switch { selector, cases: new }, Span::UNDEFINED);
                }
            }
            _ => return Err(no_way_back(self.shared.name(self.function))),
        }
        Ok(())
    }

    /// True if a value that varies changes in a statement.
    pub(super) fn is_active(&mut self, statement: &Statement) -> bool {
        match statement {
            Statement::Store { pointer, .. } => self.varies(*pointer),
            Statement::Call { function, arguments, .. } => match rule(self.shared.name(*function)) {
                Some(Rule::Note) => self.varies(arguments[1]),
                Some(_) => false,
                None => {
                    let mask = self.shared.mask(self.function, arguments, &self.activity.varied);
                    self.shared.activity(*function, &mask).has_effects
                }
            },
            other => inner_blocks(other).flat_map(|block| block.iter()).any(|inner| self.is_active(inner)),
        }
    }

    pub(super) fn call(
        &mut self,
        statement: &Statement,
        function: Handle<Function>,
        arguments: &[Value],
        result: Option<Value>,
        out: &mut Block,
    ) -> Result<()> {
        let mut adjoint = Adjoint::default();
        if let Some(result) = result.filter(|result| self.varies(*result)) {
            let ty = self.type_of(result);
            adjoint = self.take(result, ty, out);
        }
        let rule = rule(self.shared.name(function));
        if rule == Some(Rule::Note) {
            if self.varies(arguments[1]) {
                let cell = self.value(arguments[0]);
                let told = self.shared.rewriting.plain(ADJOINT_OF)?;
                let found = self.call_for_result(told, vec![cell], out);
                self.contribute_whole(arguments[1], found, out);
            }
            return Ok(());
        }
        let Some(rule) = rule else {
            return self.call_back(statement, function, arguments, result, adjoint, out);
        };
        let Some(result) = result.filter(|_| !adjoint.is_zero()) else { return Ok(()) };
        let ty = self.type_of(result);
        match self.linearised_call(rule, arguments, result, out)? {
            Some(change) => self.transposed_change(&change, adjoint, ty, out),
            None => Ok(()),
        }
    }

    pub(super) fn call_back(
        &mut self,
        statement: &Statement,
        function: Handle<Function>,
        arguments: &[Value],
        result: Option<Value>,
        adjoint: Adjoint,
        out: &mut Block,
    ) -> Result<()> {
        let mask = self.shared.mask(self.function, arguments, &self.activity.varied);
        let activity = self.shared.activity(function, &mask);
        if !activity.has_effects && adjoint.is_zero() {
            return Ok(());
        }
        let made = self.shared.transposed(function, &mask)?;
        let member = made.record.map(|ty| {
            let known = self.record.calls.get(&key_of(statement)).and_then(|(_, member)| *member);
            known.unwrap_or_else(|| {
                self.record.types.push(ty);
                self.record.types.len() as u32 - 1
            })
        });
        self.record.calls.insert(key_of(statement), (made.forward, member));
        let mut all = Vec::new();
        for (argument, varies) in arguments.iter().zip(&mask) {
            if *varies && self.is_pointer(*argument) {
                let pointer = self.adjoint_pointer(*argument, out);
                all.push(pointer.ok_or_else(|| no_way_back(self.shared.name(function)))?);
            }
        }
        if let (true, Some(result)) = (made.varies, result) {
            let ty = self.type_of(result);
            let value = self.materialised(&adjoint, ty, out);
            all.push(value.unwrap_or_else(|| self.append(Expression::ZeroValue(ty))));
        }
        if let Some(member) = member {
            all.push(self.member_of_record(member));
        }
        if made.adjoints.is_none() {
            let call = Statement::Call { function: made.back, arguments: all, result: None };
            out.push(call, Span::UNDEFINED);
            return Ok(());
        }
        let adjoints = self.call_for_result(made.back, all, out);
        for (argument, member) in arguments.iter().zip(&made.members) {
            if let Some(member) = member {
                let adjoint = self.part(adjoints, *member, out);
                self.contribute_whole(*argument, adjoint, out);
            }
        }
        Ok(())
    }
}

/// Statements, with the contents of nested plain blocks in their place.
fn flat<'m>(statements: &[&'m Statement]) -> Vec<&'m Statement> {
    let mut found = Vec::new();
    for statement in statements {
        match statement {
            Statement::Block(block) => found.extend(flat(&block.iter().collect::<Vec<_>>())),
            other => found.push(*other),
        }
    }
    found
}

/// True if the function may end in a statement.
fn returns(statement: &Statement) -> bool {
    matches!(statement, Statement::Return { .. })
        || inner_blocks(statement).flat_map(|block| block.iter()).any(returns)
}

/// True if a statement may leave the switch that it stands in. Loops and switches within it are left by what stands in them.
fn breaks(statement: &Statement) -> bool {
    match statement {
        Statement::Break => true,
        Statement::Loop { .. } | Statement::Switch { .. } => false,
        other => inner_blocks(other).flat_map(|block| block.iter()).any(breaks),
    }
}
