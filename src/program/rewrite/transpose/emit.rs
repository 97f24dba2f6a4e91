//! A function that is written from its beginning to its end.

use crate::program::rewrite::function_builder::FunctionBuilder;
use naga::{Block, Expression, Function, Handle, Span, Statement};

#[derive(Default)]
pub(super) struct Emitter {
    pub(super) new: Function,
    pub(super) body: Block,
}

impl FunctionBuilder for Emitter {
    fn new_function(&mut self) -> &mut Function {
        &mut self.new
    }
}

impl Emitter {
    /// A function that is to be called as an old one.
    pub(super) fn of(old: &Function) -> Self {
        let new = Function { name: old.name.clone(), arguments: old.arguments.clone(), ..Default::default() };
        Emitter { new, body: Block::new() }
    }

    /// An expression that is evaluated next.
    pub(super) fn now(&mut self, expression: Expression) -> Handle<Expression> {
        let mut body = std::mem::take(&mut self.body);
        let value = self.emit(expression, &mut body);
        self.body = body;
        value
    }

    /// The result of a call that is made next.
    pub(super) fn call_now(
        &mut self,
        function: Handle<Function>,
        arguments: Vec<Handle<Expression>>,
    ) -> Handle<Expression> {
        let mut body = std::mem::take(&mut self.body);
        let value = self.call_for_result(function, arguments, &mut body);
        self.body = body;
        value
    }

    /// A write that is made next.
    pub(super) fn store(&mut self, pointer: Handle<Expression>, value: Handle<Expression>) {
        self.body.push(Statement::Store { pointer, value }, Span::UNDEFINED);
    }

    /// The function as written.
    pub(super) fn finished(self) -> Function {
        Function { body: self.body, ..self.new }
    }
}
