/* Start-up code of a Cortex-M4F that runs before the start-up code of newlib. */
.syntax unified
.thumb
.section .vectors, "a"
.word stack_top, reset, fault, fault
.text
.thumb_func
fault: b fault
.thumb_func
reset: ldr r0, =0xE000ED88 /* turn the floating-point unit on */
ldr r1, [r0]
orr r1, r1, #0xF00000
str r1, [r0]
dsb
isb
b _mainCRTStartup
