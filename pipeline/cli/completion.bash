# bash completion for gaitsweep; in ~/.bashrc: eval "$(gaitsweep completion bash)"
_gaitsweep() {
  local word="${COMP_WORDS[COMP_CWORD]}" before="${COMP_WORDS[COMP_CWORD-1]}" command="" words="" one
  for one in "${COMP_WORDS[@]:1:COMP_CWORD-1}"; do
    case "$one" in @commands@) command="$one"; break;; esac
  done
  case "$command" in
@cases@
    *) words="@top@";;
  esac
  case "$before" in
    --walker) words="@walkers@";;
    --free|--tuned) words="@keys@";;
    --set) words="@settings@"; compopt -o nospace 2>/dev/null;;
  esac
  COMPREPLY=($(compgen -W "$words" -- "$word"))
  if [ -n "$command" ] && [ "${word#-}" = "$word" ]; then COMPREPLY+=($(compgen -f -- "$word")); fi
}
complete -o filenames -F _gaitsweep gaitsweep
