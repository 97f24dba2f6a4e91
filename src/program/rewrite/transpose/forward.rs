//! Writes the half of a function that goes forward: the function as it was, which records what the way back needs.

use crate::error::Result;
use crate::program::rewrite::function_builder::{FunctionBuilder, Rewrite};
use crate::program::rewrite::rules::{Rule, rule};
use crate::program::rewrite::transpose::record::{Record, key_of};
use crate::program::rewrite::transpose::transposer::Transposer;
use naga::{
    AddressSpace, Block, Expression, Function, FunctionArgument, Handle, LocalVariable, Span, Statement,
    Type, TypeInner,
};

/// The function; a last argument points to the record, if there is one.
pub(super) fn write(
    shared: &mut Transposer,
    function: Handle<Function>,
    record: &Record,
    ty: Option<Handle<Type>>,
) -> Result<Function> {
    let old = &shared.module.functions[function];
    let mut new = old.clone();
    new.name = old.name.as_ref().map(|name| format!("{name}_forward"));
    new.body = Block::new();
    let pointer = ty.map(|ty| {
        let ty = shared.type_with(TypeInner::Pointer { base: ty, space: AddressSpace::Function });
        new.arguments.push(FunctionArgument { name: Some("record".into()), ty, binding: None });
        new.expressions.append(Expression::FunctionArgument(new.arguments.len() as u32 - 1), Span::UNDEFINED)
    });
    let mut forward = Forward { shared, record, new, pointer };
    let mut body = Block::new();
    for (value, expression) in old.expressions.iter() {
        if matches!(expression, Expression::FunctionArgument(_)) {
            forward.keep(value, &mut body);
        }
    }
    body.extend_block(forward.block(&old.body)?);
    forward.new.body = body;
    Ok(forward.new)
}

struct Forward<'r, 'm> {
    shared: &'r Transposer<'m>,
    record: &'r Record,
    new: Function,
    /// To the record.
    pointer: Option<Handle<Expression>>,
}

impl FunctionBuilder for Forward<'_, '_> {
    fn new_function(&mut self) -> &mut Function {
        &mut self.new
    }
}

impl Rewrite for Forward<'_, '_> {
    /// The function keeps its expressions.
    fn value(&mut self, old: Handle<Expression>) -> Result<Handle<Expression>> {
        Ok(old)
    }

    fn statement(&mut self, statement: &Statement, out: &mut Block) -> Result<()> {
        let new = match statement {
            Statement::Emit(range) => {
                out.push(statement.clone(), Span::UNDEFINED);
                range.clone().for_each(|value| self.keep(value, out));
                return Ok(());
            }
            Statement::Call { function, arguments, result } => {
                return self.call(statement, *function, arguments, *result, out);
            }
            other => self.control(other)?.unwrap_or_else(|| other.clone()),
        };
        out.push(new, Span::UNDEFINED);
        Ok(())
    }
}

impl Forward<'_, '_> {
    /// A pointer to a member of the record.
    fn member(&mut self, index: u32, out: &mut Block) -> Option<Handle<Expression>> {
        let base = self.pointer?;
        Some(self.emit(Expression::AccessIndex { base, index }, out))
    }

    /// Records a value, if the way back needs it.
    fn keep(&mut self, value: Handle<Expression>, out: &mut Block) {
        let Some(index) = self.record.values.get(&value) else { return };
        if let Some(pointer) = self.member(*index, out) {
            out.push(Statement::Store { pointer, value }, Span::UNDEFINED);
        }
    }

    fn call(
        &mut self,
        statement: &Statement,
        function: Handle<Function>,
        arguments: &[Handle<Expression>],
        result: Option<Handle<Expression>>,
        out: &mut Block,
    ) -> Result<()> {
        let mut arguments = arguments.to_vec();
        let mut kept = None;
        let function = match (rule(self.shared.name(function)), self.record.calls.get(&key_of(statement))) {
            (Some(Rule::Note), _) => return Ok(()),
            (Some(Rule::Recalled(name)), _) => self.shared.rewriting.plain(name)?,
            (_, Some((forward, member))) => {
                if let Some(member) = member {
                    // Pointers to members cannot be given to functions.
                    let ty = self.record.types[*member as usize];
                    let variable = LocalVariable { name: Some("record".into()), ty, init: None };
                    let variable = self.new.local_variables.append(variable, Span::UNDEFINED);
                    let pointer = self.append(Expression::LocalVariable(variable));
                    arguments.push(pointer);
                    kept = Some((*member, pointer));
                }
                *forward
            }
            _ => self.shared.plain(function),
        };
        if let Some(result) = result {
            self.new.expressions[result] = Expression::CallResult(function);
        }
        out.push(Statement::Call { function, arguments, result }, Span::UNDEFINED);
        if let Some((member, pointer)) = kept {
            let value = self.emit(Expression::Load { pointer }, out);
            if let Some(pointer) = self.member(member, out) {
                out.push(Statement::Store { pointer, value }, Span::UNDEFINED);
            }
        }
        result.into_iter().for_each(|result| self.keep(result, out));
        Ok(())
    }
}
