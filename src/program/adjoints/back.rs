//! Writes the half of a function that goes back: from adjoints of what it gave to adjoints of what it took.
//!
//! Statements are taken from the last to the first. Values of the way forward come from the record. Of two branches that was
//! taken which the recorded condition tells. Loops in which a value that varies changes have no way back.

use crate::error::{Error, Result};
use crate::program::adjoints::activity::{Activity, is_pointer};
use crate::program::adjoints::adjoint::Adjoint;
use crate::program::adjoints::forward;
use crate::program::adjoints::transposing::{Transposed, Transposing};
use crate::program::adjoints::{ADJOINT_OF, no_way_back};
use crate::program::statements::Write;
use crate::program::tangents::rules::{Rule, rule};
use naga::{
    AddressSpace, BinaryOperator, Block, Expression, Function, FunctionArgument, Handle, Literal,
    LocalVariable, MathFunction, ScalarKind, Span, Statement, SwitchCase, Type, TypeInner, UnaryOperator,
};
use std::collections::HashMap;

type Value = Handle<Expression>;

/// The block of the function's body, to which its arguments belong.
const ROOT: usize = 1;

/// A statement of the old function, by its address.
pub(super) fn key_of(statement: &Statement) -> usize {
    std::ptr::from_ref(statement) as usize
}

/// What the way back needs of the way forward.
#[derive(Default)]
pub(super) struct Record {
    /// Types of its members.
    pub(super) types: Vec<Handle<Type>>,
    /// Members that hold values.
    pub(super) values: HashMap<Value, u32>,
    /// Calls whose functions have a way back, by their statements: the half that goes forward, and the member that holds its
    /// record.
    pub(super) calls: HashMap<usize, (Handle<Function>, Option<u32>)>,
}

impl Transposing<'_> {
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
        let mut out = Block::new();
        let arguments: Vec<(Handle<Type>, Value)> = (0..)
            .zip(&back.old.arguments)
            .map(|(index, argument)| (argument.ty, index))
            .collect::<Vec<_>>()
            .into_iter()
            .map(|(ty, index)| (ty, back.append(Expression::FunctionArgument(index))))
            .collect();
        back.new.name = back.old.name.clone();
        back.new.arguments = back.old.arguments.clone();
        let mut forward: Vec<Value> = arguments[..mask.len()].iter().map(|(_, value)| *value).collect();
        let mut adjoints = arguments[mask.len()..].iter().map(|(_, value)| *value);
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
                back.call_plain(made.forward, forward, &mut out);
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
            let found = back.call_plain(made.back, given, &mut out);
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

struct Back<'r, 'm> {
    shared: &'r mut Transposing<'m>,
    function: Handle<Function>,
    old: &'m Function,
    activity: Activity,
    new: Function,
    /// Where the record is read.
    prologue: Block,
    record: Record,
    record_argument: u32,
    /// Values of the way forward.
    known: HashMap<Value, Value>,
    /// Pointers to adjoints, by the number of the argument that points to the reals.
    pointers: HashMap<u32, Value>,
    locals: HashMap<Handle<LocalVariable>, Handle<LocalVariable>>,
    adjoints: HashMap<Value, Adjoint>,
    /// Adjoints that come from other blocks than that of the value.
    variables: HashMap<Value, Handle<LocalVariable>>,
    /// The block in which a value is computed.
    homes: HashMap<Value, usize>,
    block: usize,
    num_blocks: usize,
    /// The adjoint of the result.
    result: Option<Value>,
}

impl Write for Back<'_, '_> {
    fn new_function(&mut self) -> &mut Function {
        &mut self.new
    }
}

impl<'r, 'm> Back<'r, 'm> {
    fn new(shared: &'r mut Transposing<'m>, function: Handle<Function>, activity: Activity) -> Self {
        let old = &shared.module.functions[function];
        let name = format!("{}_back", old.name.as_deref().unwrap_or_default());
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

    fn write(mut self, mask: &[bool]) -> Result<Transposed> {
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
        let forward = forward::write(self.shared, self.function, &self.record, record);
        let functions = &mut self.shared.rewriting.new.functions;
        let forward = functions.append(forward, Span::UNDEFINED);
        let back = functions.append(std::mem::take(&mut self.new), Span::UNDEFINED);
        Ok(Transposed { forward, back, record, adjoints, members, varies })
    }

    fn argument(&mut self, name: Option<String>, ty: Handle<Type>) -> Value {
        let index = self.new.arguments.len() as u32;
        self.new.arguments.push(FunctionArgument { name, ty, binding: None });
        self.append(Expression::FunctionArgument(index))
    }

    /// The old value of an argument, if the function uses it.
    fn old_argument(&self, index: u32) -> Option<Value> {
        let mut all = self.old.expressions.iter();
        all.find(|(_, expression)| matches!(expression, Expression::FunctionArgument(i) if *i == index))
            .map(|(handle, _)| handle)
    }

    fn varies(&self, old: Value) -> bool {
        self.activity.varied.contains(&old)
    }

    fn is_pointer(&self, old: Value) -> bool {
        is_pointer(self.shared.inner(self.function, old))
    }

    fn type_of(&mut self, old: Value) -> Handle<Type> {
        self.shared.type_of(self.function, old)
    }

    fn inner(&self, ty: Handle<Type>) -> &TypeInner {
        &self.shared.rewriting.new.types[ty].inner
    }

    fn real_type(&mut self) -> Handle<Type> {
        let real = self.shared.rewriting.real;
        self.shared.type_with(TypeInner::Scalar(real))
    }

    /// The value that an old expression had on the way forward.
    fn value(&mut self, old: Value) -> Value {
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

    fn member_of_record(&mut self, index: u32) -> Value {
        let base = self.append(Expression::FunctionArgument(self.record_argument));
        let mut prologue = std::mem::take(&mut self.prologue);
        let member = self.emit(Expression::AccessIndex { base, index }, &mut prologue);
        self.prologue = prologue;
        member
    }

    // Adjoints.

    /// The type of a part.
    fn part_type(&mut self, ty: Handle<Type>, index: u32) -> Handle<Type> {
        match self.inner(ty).clone() {
            TypeInner::Struct { members, .. } => members[index as usize].ty,
            TypeInner::Array { base, .. } => base,
            _ => self.real_type(),
        }
    }

    fn part(&mut self, base: Value, index: u32, out: &mut Block) -> Value {
        self.emit(Expression::AccessIndex { base, index }, out)
    }

    /// The parts of an adjoint of a struct or an array, of which all that hold reals are there if it was known as a whole.
    fn parts(&mut self, adjoint: Adjoint, ty: Handle<Type>, out: &mut Block) -> Adjoint {
        let Some(whole) = adjoint.whole else { return adjoint };
        let parts: Vec<(u32, Handle<Type>)> = match self.inner(ty).clone() {
            TypeInner::Struct { members, .. } => {
                (0..).zip(members).map(|(i, member)| (i, member.ty)).collect()
            }
            TypeInner::Array { base, size: naga::ArraySize::Constant(num), .. } => {
                (0..num.get()).map(|i| (i, base)).collect()
            }
            _ => return adjoint,
        };
        let mut all = Adjoint { whole: None, parts: adjoint.parts };
        for (index, ty) in parts {
            if self.shared.rewriting.has_reals(ty) {
                let part = Adjoint::whole(self.part(whole, index, out));
                let known = all.parts.remove(&index).unwrap_or_default();
                let sum = self.sum(known, part, ty, out);
                all.parts.insert(index, sum);
            }
        }
        all
    }

    fn is_composite(&self, ty: Handle<Type>) -> bool {
        matches!(self.inner(ty), TypeInner::Struct { .. } | TypeInner::Array { .. })
    }

    fn sum(&mut self, left: Adjoint, right: Adjoint, ty: Handle<Type>, out: &mut Block) -> Adjoint {
        if left.is_zero() {
            return right;
        }
        if right.is_zero() {
            return left;
        }
        let (mut left, mut right) = (left, right);
        if self.is_composite(ty) {
            left = self.parts(left, ty, out);
            right = self.parts(right, ty, out);
        }
        left.whole = match (left.whole, right.whole) {
            (Some(a), Some(b)) => Some(self.binary(BinaryOperator::Add, a, b, out)),
            (one, other) => one.or(other),
        };
        for (index, part) in right.parts {
            let known = left.parts.remove(&index).unwrap_or_default();
            let ty = self.part_type(ty, index);
            let sum = self.sum(known, part, ty, out);
            left.parts.insert(index, sum);
        }
        left
    }

    /// An adjoint as one value; none if it is zero.
    fn materialised(&mut self, adjoint: &Adjoint, ty: Handle<Type>, out: &mut Block) -> Option<Value> {
        if adjoint.is_zero() {
            return None;
        }
        if adjoint.parts.is_empty() {
            return adjoint.whole;
        }
        let adjoint = match self.is_composite(ty) {
            true => self.parts(adjoint.clone(), ty, out),
            false => adjoint.clone(),
        };
        let num = match self.inner(ty) {
            TypeInner::Struct { members, .. } => members.len() as u32,
            TypeInner::Vector { size, .. } => *size as u32,
            TypeInner::Array { size: naga::ArraySize::Constant(num), .. } => num.get(),
            _ => 0,
        };
        let mut components = Vec::new();
        for index in 0..num {
            let part_ty = self.part_type(ty, index);
            let mut part = adjoint.parts.get(&index).cloned().unwrap_or_default();
            if let Some(whole) = adjoint.whole {
                let of_whole = Adjoint::whole(self.part(whole, index, out));
                part = self.sum(part, of_whole, part_ty, out);
            }
            let value = self.materialised(&part, part_ty, out);
            components.push(value.unwrap_or_else(|| self.append(Expression::ZeroValue(part_ty))));
        }
        Some(self.emit(Expression::Compose { ty, components }, out))
    }

    /// Adds to the adjoint of an old value.
    fn contribute(&mut self, old: Value, adjoint: Adjoint, out: &mut Block) {
        if adjoint.is_zero() || !self.varies(old) {
            return;
        }
        let ty = self.type_of(old);
        let home = match &self.old.expressions[old] {
            Expression::FunctionArgument(_) => ROOT,
            _ => self.homes.get(&old).copied().unwrap_or_default(),
        };
        if home == self.block {
            let known = self.adjoints.remove(&old).unwrap_or_default();
            let sum = self.sum(known, adjoint, ty, out);
            self.adjoints.insert(old, sum);
            return;
        }
        let variable = match self.variables.get(&old) {
            Some(variable) => *variable,
            None => {
                let variable = LocalVariable { name: Some("adjoint".into()), ty, init: None };
                let variable = self.new.local_variables.append(variable, Span::UNDEFINED);
                self.variables.insert(old, variable);
                variable
            }
        };
        let pointer = self.append(Expression::LocalVariable(variable));
        self.add_to_memory(pointer, ty, adjoint, out);
    }

    fn contribute_whole(&mut self, old: Value, value: Value, out: &mut Block) {
        self.contribute(old, Adjoint::whole(value), out);
    }

    /// The adjoint of an old value where the value is computed.
    fn take(&mut self, old: Value, ty: Handle<Type>, out: &mut Block) -> Adjoint {
        let known = self.adjoints.remove(&old).unwrap_or_default();
        let Some(variable) = self.variables.get(&old) else { return known };
        let pointer = self.append(Expression::LocalVariable(*variable));
        let loaded = self.emit(Expression::Load { pointer }, out);
        self.sum(known, Adjoint::whole(loaded), ty, out)
    }

    fn add_to_memory(&mut self, pointer: Value, ty: Handle<Type>, adjoint: Adjoint, out: &mut Block) {
        let adjoint = if self.is_composite(ty) { self.parts(adjoint, ty, out) } else { adjoint };
        if let Some(whole) = adjoint.whole {
            let before = self.emit(Expression::Load { pointer }, out);
            let value = self.binary(BinaryOperator::Add, before, whole, out);
            out.push(Statement::Store { pointer, value }, Span::UNDEFINED);
        }
        for (index, part) in adjoint.parts {
            if !part.is_zero() {
                let ty = self.part_type(ty, index);
                let pointer = self.part(pointer, index, out);
                self.add_to_memory(pointer, ty, part, out);
            }
        }
    }

    /// A pointer to the adjoints of what an old pointer points to; none of what has no adjoints.
    fn adjoint_pointer(&mut self, pointer: Value, out: &mut Block) -> Option<Value> {
        Some(match self.old.expressions[pointer].clone() {
            Expression::LocalVariable(variable) => {
                let twin = match self.locals.get(&variable) {
                    Some(twin) => *twin,
                    None => {
                        let old = &self.old.local_variables[variable];
                        let name = old.name.as_ref().map(|name| format!("{name}_adjoint"));
                        let twin = LocalVariable { name, ty: old.ty, init: None };
                        let twin = self.new.local_variables.append(twin, Span::UNDEFINED);
                        self.locals.insert(variable, twin);
                        twin
                    }
                };
                self.append(Expression::LocalVariable(twin))
            }
            Expression::GlobalVariable(variable) => {
                let twin = *self.shared.twins.get(&variable)?;
                self.append(Expression::GlobalVariable(twin))
            }
            Expression::FunctionArgument(index) => *self.pointers.get(&index)?,
            Expression::AccessIndex { base, index } => {
                let base = self.adjoint_pointer(base, out)?;
                self.part(base, index, out)
            }
            Expression::Access { base, index } => {
                let base = self.adjoint_pointer(base, out)?;
                let index = self.value(index);
                self.emit(Expression::Access { base, index }, out)
            }
            _ => return None,
        })
    }

    // Statements.

    /// Goes back over statements, which end where the function does: what follows a branch that may return stands within its
    /// other branches.
    fn list(&mut self, statements: &[&'m Statement], out: &mut Block) -> Result<()> {
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

    fn statement(&mut self, statement: &'m Statement, out: &mut Block) -> Result<()> {
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
            // Nothing else tells a value that varies.
            _ => {}
        }
        Ok(())
    }

    /// Goes back over the branches of a statement, each of which goes on with the same statements.
    fn branches(&mut self, statement: &'m Statement, after: &[&'m Statement], out: &mut Block) -> Result<()> {
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
    fn is_active(&mut self, statement: &Statement) -> bool {
        let mut any = |block: &Block| block.iter().any(|statement| self.is_active(statement));
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
            Statement::Block(block) => any(block),
            Statement::If { accept, reject, .. } => any(accept) || any(reject),
            Statement::Switch { cases, .. } => cases.iter().any(|case| any(&case.body)),
            Statement::Loop { body, continuing, .. } => any(body) || any(continuing),
            _ => false,
        }
    }

    fn call(
        &mut self,
        statement: &Statement,
        function: Handle<Function>,
        arguments: &[Value],
        result: Option<Value>,
        out: &mut Block,
    ) -> Result<()> {
        use BinaryOperator::{Divide, Multiply};
        let mut adjoint = Adjoint::default();
        if let Some(result) = result.filter(|result| self.varies(*result)) {
            let ty = self.type_of(result);
            adjoint = self.take(result, ty, out);
        }
        let rule = rule(self.shared.name(function));
        if rule == Some(Rule::Note) {
            if self.varies(arguments[1]) {
                let cell = self.value(arguments[0]);
                let found = self.shared.function(ADJOINT_OF)?;
                let found = self.call_plain(self.shared.plain(found), vec![cell], out);
                self.contribute_whole(arguments[1], found, out);
            }
            return Ok(());
        }
        let whole = match (rule, result) {
            (Some(_), Some(result)) => {
                let ty = self.type_of(result);
                self.materialised(&adjoint, ty, out)
            }
            _ => None,
        };
        match (rule, whole, result) {
            (None, ..) => return self.call_back(statement, function, arguments, result, adjoint, out),
            (Some(Rule::Attached), Some(whole), _) => self.contribute_whole(arguments[1], whole, out),
            (Some(Rule::Exponential), Some(whole), Some(result)) => {
                let result = self.value(result);
                let product = self.binary(Multiply, whole, result, out);
                self.contribute_whole(arguments[0], product, out);
            }
            (Some(Rule::Logarithm), Some(whole), _) => {
                let argument = self.value(arguments[0]);
                let quotient = self.binary(Divide, whole, argument, out);
                self.contribute_whole(arguments[0], quotient, out);
            }
            (Some(Rule::Turned(name, sign)), Some(whole), _) => {
                let function = self.shared.function(name)?;
                let argument = self.value(arguments[0]);
                let turned = self.call_plain(self.shared.plain(function), vec![argument], out);
                let sign = self.literal(sign);
                let slope = self.binary(Multiply, turned, sign, out);
                let product = self.binary(Multiply, whole, slope, out);
                self.contribute_whole(arguments[0], product, out);
            }
            _ => {}
        }
        Ok(())
    }

    fn call_back(
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
        let adjoints = self.call_plain(made.back, all, out);
        for (argument, member) in arguments.iter().zip(&made.members) {
            if let Some(member) = member {
                let adjoint = self.part(adjoints, *member, out);
                self.contribute_whole(*argument, adjoint, out);
            }
        }
        Ok(())
    }

    // Expressions.

    fn literal(&mut self, value: f64) -> Value {
        self.append(Expression::Literal(match self.shared.rewriting.real.width {
            8 => Literal::F64(value),
            _ => Literal::F32(value as f32),
        }))
    }

    fn select(&mut self, condition: Value, accept: Value, reject: Value, out: &mut Block) -> Value {
        self.emit(Expression::Select { condition, accept, reject }, out)
    }

    fn negated(&mut self, expr: Value, out: &mut Block) -> Value {
        self.emit(Expression::Unary { op: UnaryOperator::Negate, expr }, out)
    }

    fn is_vector(&self, old: Value) -> bool {
        matches!(self.shared.inner(self.function, old), TypeInner::Vector { .. })
    }

    /// Hands the adjoint of an expression on to what it is made of.
    fn expression(&mut self, old: Value, out: &mut Block) -> Result<()> {
        let ty = self.type_of(old);
        let adjoint = self.take(old, ty, out);
        if adjoint.is_zero() {
            return Ok(());
        }
        let expression = self.old.expressions[old].clone();
        match expression {
            Expression::Load { pointer } => {
                if let Some(pointer) = self.adjoint_pointer(pointer, out) {
                    self.add_to_memory(pointer, ty, adjoint, out);
                }
                return Ok(());
            }
            Expression::AccessIndex { base, index } => {
                self.contribute(base, Adjoint::part(index, adjoint), out);
                return Ok(());
            }
            _ => {}
        }
        let is_composed = matches!(expression, Expression::Compose { .. });
        if is_composed && self.is_composite(ty) {
            let Expression::Compose { components, .. } = expression else { return Ok(()) };
            let mut parts = self.parts(adjoint, ty, out).parts;
            for (index, component) in (0..).zip(components) {
                self.contribute(component, parts.remove(&index).unwrap_or_default(), out);
            }
            return Ok(());
        }
        let Some(whole) = self.materialised(&adjoint, ty, out) else { return Ok(()) };
        match expression {
            Expression::Compose { components, .. } => {
                let mut first = 0;
                for component in components {
                    let inner = self.shared.inner(self.function, component).clone();
                    if let TypeInner::Vector { size, .. } = inner {
                        let parts = (first..first + size as u32).map(|i| self.part(whole, i, out)).collect();
                        let ty = self.type_of(component);
                        let part = self.emit(Expression::Compose { ty, components: parts }, out);
                        self.contribute_whole(component, part, out);
                        first += size as u32;
                    } else {
                        let part = self.part(whole, first, out);
                        self.contribute_whole(component, part, out);
                        first += 1;
                    }
                }
            }
            Expression::Splat { size, value } => {
                let mut sum = self.part(whole, 0, out);
                for index in 1..size as u32 {
                    let part = self.part(whole, index, out);
                    sum = self.binary(BinaryOperator::Add, sum, part, out);
                }
                self.contribute_whole(value, sum, out);
            }
            Expression::Swizzle { size, vector, pattern } => {
                for (index, component) in (0..size as u32).zip(pattern) {
                    let part = Adjoint::whole(self.part(whole, index, out));
                    self.contribute(vector, Adjoint::part(component as u32, part), out);
                }
            }
            Expression::Unary { op: UnaryOperator::Negate, expr } => {
                let negated = self.negated(whole, out);
                self.contribute_whole(expr, negated, out);
            }
            Expression::Binary { op, left, right } => self.arithmetic(op, [left, right], old, whole, out)?,
            Expression::Select { condition, accept, reject } => {
                let condition = self.value(condition);
                let zero = self.append(Expression::ZeroValue(ty));
                if self.varies(accept) {
                    let part = self.select(condition, whole, zero, out);
                    self.contribute_whole(accept, part, out);
                }
                if self.varies(reject) {
                    let part = self.select(condition, zero, whole, out);
                    self.contribute_whole(reject, part, out);
                }
            }
            Expression::Math { fun, arg, arg1, arg2, .. } => {
                let arguments: Vec<Value> = [Some(arg), arg1, arg2].into_iter().flatten().collect();
                self.math(fun, &arguments, old, whole, out)?;
            }
            Expression::As { expr, kind: ScalarKind::Float, .. } => self.contribute_whole(expr, whole, out),
            _ => return Err(no_way_back(self.shared.name(self.function))),
        }
        Ok(())
    }

    fn arithmetic(
        &mut self,
        op: BinaryOperator,
        [left, right]: [Value; 2],
        old: Value,
        whole: Value,
        out: &mut Block,
    ) -> Result<()> {
        use BinaryOperator::{Add, Divide, Multiply, Subtract};
        match op {
            Add => {
                self.contribute_whole(left, whole, out);
                self.contribute_whole(right, whole, out);
            }
            Subtract => {
                self.contribute_whole(left, whole, out);
                if self.varies(right) {
                    let negated = self.negated(whole, out);
                    self.contribute_whole(right, negated, out);
                }
            }
            Multiply => {
                let is_matrix = |this: &Self, old: Value| {
                    matches!(this.shared.inner(this.function, old), TypeInner::Matrix { .. })
                };
                if is_matrix(self, left) || is_matrix(self, right) {
                    return Err(no_way_back(self.shared.name(self.function)));
                }
                for (one, other) in [(left, right), (right, left)] {
                    if self.varies(one) {
                        let other_value = self.value(other);
                        // A scalar times a vector.
                        let part = match !self.is_vector(one) && self.is_vector(other) {
                            true => self.dot(whole, other_value, out),
                            false => self.binary(Multiply, whole, other_value, out),
                        };
                        self.contribute_whole(one, part, out);
                    }
                }
            }
            Divide => {
                // (a / b)' = (a' - (a / b) b') / b.
                let divisor = self.value(right);
                let over = self.binary(Divide, whole, divisor, out);
                self.contribute_whole(left, over, out);
                if self.varies(right) {
                    let quotient = self.value(old);
                    let product = self.binary(Multiply, over, quotient, out);
                    let negated = self.negated(product, out);
                    self.contribute_whole(right, negated, out);
                }
            }
            _ => return Err(no_way_back(self.shared.name(self.function))),
        }
        Ok(())
    }

    fn dot(&mut self, arg: Value, arg1: Value, out: &mut Block) -> Value {
        let fun = MathFunction::Dot;
        self.emit(Expression::Math { fun, arg, arg1: Some(arg1), arg2: None, arg3: None }, out)
    }

    fn math(
        &mut self,
        fun: MathFunction,
        old: &[Value],
        result: Value,
        whole: Value,
        out: &mut Block,
    ) -> Result<()> {
        use BinaryOperator::{Divide, Greater, Less, Multiply};
        let ty = self.type_of(old[0]);
        let zero = self.append(Expression::ZeroValue(ty));
        match fun {
            MathFunction::Abs => {
                let value = self.value(old[0]);
                let is_below = self.binary(Less, value, zero, out);
                let negated = self.negated(whole, out);
                let part = self.select(is_below, negated, whole, out);
                self.contribute_whole(old[0], part, out);
            }
            MathFunction::Min | MathFunction::Max => {
                let op = if fun == MathFunction::Min { Less } else { Greater };
                let [first, second] = [self.value(old[0]), self.value(old[1])];
                let is_second = self.binary(op, second, first, out);
                let part = self.select(is_second, zero, whole, out);
                self.contribute_whole(old[0], part, out);
                let part = self.select(is_second, whole, zero, out);
                self.contribute_whole(old[1], part, out);
            }
            MathFunction::Clamp => {
                let [x, low, high] = [0, 1, 2].map(|i| self.value(old[i]));
                let is_low = self.binary(Less, x, low, out);
                let is_high = self.binary(Greater, x, high, out);
                let within = self.select(is_low, zero, whole, out);
                let within = self.select(is_high, zero, within, out);
                self.contribute_whole(old[0], within, out);
                let below = self.select(is_low, whole, zero, out);
                let below = self.select(is_high, zero, below, out);
                self.contribute_whole(old[1], below, out);
                let above = self.select(is_high, whole, zero, out);
                self.contribute_whole(old[2], above, out);
            }
            MathFunction::Sqrt => {
                // As on the way forward, a root of 0 has no slope.
                let root = self.value(result);
                let is_positive = self.binary(Greater, root, zero, out);
                let doubled = self.binary(BinaryOperator::Add, root, root, out);
                let slope = self.binary(Divide, whole, doubled, out);
                let part = self.select(is_positive, slope, zero, out);
                self.contribute_whole(old[0], part, out);
            }
            MathFunction::Fma => {
                for (one, other) in [(old[0], old[1]), (old[1], old[0])] {
                    if self.varies(one) {
                        let other = self.value(other);
                        let part = self.binary(Multiply, whole, other, out);
                        self.contribute_whole(one, part, out);
                    }
                }
                self.contribute_whole(old[2], whole, out);
            }
            MathFunction::Dot => {
                for (one, other) in [(old[0], old[1]), (old[1], old[0])] {
                    if self.varies(one) {
                        let other = self.value(other);
                        let part = self.binary(Multiply, whole, other, out);
                        self.contribute_whole(one, part, out);
                    }
                }
            }
            MathFunction::Cross => {
                // y' = a' x b + a x b', so that y . (a' x b) = a' . (b x y).
                let cross = |this: &mut Self, arg: Value, arg1: Value, out: &mut Block| {
                    this.emit(Expression::Math { fun, arg, arg1: Some(arg1), arg2: None, arg3: None }, out)
                };
                let [a, b] = [self.value(old[0]), self.value(old[1])];
                let part = cross(self, b, whole, out);
                self.contribute_whole(old[0], part, out);
                let part = cross(self, whole, a, out);
                self.contribute_whole(old[1], part, out);
            }
            MathFunction::Floor | MathFunction::Ceil | MathFunction::Trunc | MathFunction::Round => {}
            _ => return Err(no_way_back(self.shared.name(self.function))),
        }
        Ok(())
    }
}

/// Statements without blocks that decide nothing.
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
    let any = |block: &Block| block.iter().any(returns);
    match statement {
        Statement::Return { .. } => true,
        Statement::Block(block) => any(block),
        Statement::If { accept, reject, .. } => any(accept) || any(reject),
        Statement::Switch { cases, .. } => cases.iter().any(|case| any(&case.body)),
        Statement::Loop { body, continuing, .. } => any(body) || any(continuing),
        _ => false,
    }
}

/// True if a statement may leave the switch that it stands in.
fn breaks(statement: &Statement) -> bool {
    let any = |block: &Block| block.iter().any(breaks);
    match statement {
        Statement::Break => true,
        Statement::Block(block) => any(block),
        Statement::If { accept, reject, .. } => any(accept) || any(reject),
        _ => false,
    }
}

/// A pointer to what a function keeps for its way back.
pub(super) fn pointer_to(base: Handle<Type>) -> TypeInner {
    TypeInner::Pointer { base, space: AddressSpace::Function }
}
